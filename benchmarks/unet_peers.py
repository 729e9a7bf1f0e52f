"""The paper's U-Net in PyTorch and for ONNX Runtime, from the parameters of `jshape.models.unet`.

Both take and give images (B, h, w) as jshape's does: sides are padded to multiples of 16 inside.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jshape.models.unet import LEVELS


def channels_first(kernel: Any) -> np.ndarray:
    """A copy of a kernel (height, width, in, out) as both peers want it: out and in first."""
    return np.array(np.asarray(kernel).transpose(3, 2, 0, 1), order="C")


def torch_network(params: dict[str, Any], torch: Any) -> tuple[Callable, list[Any]]:
    """(images -> images, its parameters in the order of jshape's leaves).

    Channels last, which is PyTorch's faster layout here.
    """
    nn = torch.nn.functional

    def tensor(array: Any) -> Any:
        if array.ndim < 4:
            made = torch.from_numpy(np.array(array))
        else:
            made = torch.from_numpy(channels_first(array)).contiguous(
                memory_format=torch.channels_last
            )
        return made.requires_grad_()

    tree = jax.tree.map(tensor, params)

    def conv(x: Any, layer: dict[str, Any]) -> Any:
        return nn.conv2d(x, layer["kernel"], layer["bias"], padding=layer["kernel"].shape[-1] // 2)

    def block(x: Any, layers: dict[str, Any]) -> Any:
        return torch.relu_(conv(torch.relu_(conv(x, layers["first"])), layers["second"]))

    def apply(image: Any) -> Any:
        h, w = image.shape[1:]
        unit = 2**LEVELS
        x = nn.pad(image[:, None], (0, -w % unit, 0, -h % unit), mode="replicate")
        x = x.contiguous(memory_format=torch.channels_last)
        skips = []
        for level in range(LEVELS):
            x = block(x, tree["down"][level])
            skips.append(x)
            x = nn.max_pool2d(x, 2)
        x = block(x, tree["bottom"])
        for level in range(LEVELS):
            x = nn.interpolate(x, scale_factor=2, mode="nearest")
            x = block(torch.cat([skips.pop(), x], 1), tree["up"][level])
        return torch.tanh(conv(x, tree["output"]))[:, 0, :h, :w]

    return apply, jax.tree.leaves(tree)


def onnx_model(params: dict[str, Any], shape: tuple[int, int, int]) -> bytes:
    """The network for images of this shape (B, h, w) as an ONNX file, from `roi` to `after`."""
    from onnx import TensorProto, helper, numpy_helper

    nodes, constants = [], []

    def constant(values: Any) -> str:
        constants.append(numpy_helper.from_array(np.asarray(values), f"constant{len(constants)}"))
        return constants[-1].name

    def node(kind: str, *inputs: str, **attributes: Any) -> str:
        output = f"{kind}{len(nodes)}"
        nodes.append(helper.make_node(kind, list(inputs), [output], **attributes))
        return output

    def conv(x: str, layer: dict[str, Any]) -> str:
        around = layer["kernel"].shape[0] // 2
        kernel, bias = constant(channels_first(layer["kernel"])), constant(layer["bias"])
        return node("Conv", x, kernel, bias, pads=[around] * 4)

    def block(x: str, layers: dict[str, Any]) -> str:
        return node("Relu", conv(node("Relu", conv(x, layers["first"])), layers["second"]))

    (h, w), unit = shape[1:], 2**LEVELS
    pads = np.array([0, 0, 0, 0, -h % unit, -w % unit])
    x = node("Unsqueeze", node("Pad", "roi", constant(pads), mode="edge"), constant([1]))
    twice = constant(np.array([1, 1, 2, 2], np.float32))
    skips = []
    for level in range(LEVELS):
        x = block(x, params["down"][level])
        skips.append(x)
        x = node("MaxPool", x, kernel_shape=[2, 2], strides=[2, 2])
    x = block(x, params["bottom"])
    for level in range(LEVELS):
        x = node("Resize", x, "", twice, mode="nearest",
                 coordinate_transformation_mode="asymmetric", nearest_mode="floor")  # fmt: skip
        x = block(node("Concat", skips.pop(), x, axis=1), params["up"][level])
    x = node("Squeeze", node("Tanh", conv(x, params["output"])), constant([1]))
    x = node("Slice", x, constant([0, 0]), constant([h, w]), constant([1, 2]))
    nodes[-1].output[0] = "after"
    images = (helper.make_tensor_value_info(n, TensorProto.FLOAT, shape) for n in ("roi", "after"))
    graph = helper.make_graph(nodes, "unet", [next(images)], [next(images)], constants)
    opset = helper.make_opsetid("", 18)
    model = helper.make_model(graph, opset_imports=[opset], ir_version=9)
    return model.SerializeToString()


def onnx_network(params: dict[str, Any], shape: tuple[int, int, int], threads: int) -> Callable:
    """Images -> images (NumPy) by ONNX Runtime on the CPU, with all of its optimizations."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(
        onnx_model(params, shape), options, providers=["CPUExecutionProvider"]
    )
    return lambda image: session.run(None, {"roi": image})[0]
