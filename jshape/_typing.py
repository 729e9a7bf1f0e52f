"""Array annotations with shapes: real jaxtyping where it is installed, inert stand-ins elsewhere.

jaxtyping is a development dependency: the test run checks every annotated shape with it
(tests/conftest.py), users never need it.
"""

from typing import TYPE_CHECKING, Any

from jax import Array

if TYPE_CHECKING:
    # For the type checker `Float[Array, "H W"]` is just the array type.
    from typing import Annotated as Bool
    from typing import Annotated as Float
    from typing import Annotated as Int
    from typing import Annotated as Key
    from typing import Annotated as Num

    from numpy.typing import ArrayLike
else:
    ArrayLike = Any  # lists and tuples too; the functions themselves check what matters
    try:
        from jaxtyping import Bool, Float, Int, Key, Num
    except ImportError:

        class _Inert:
            """`Float[Array, "H W"]` evaluates to `Array`."""

            def __class_getitem__(cls, item: Any) -> Any:
                return item[0]

        Bool = Float = Int = Key = Num = _Inert

__all__ = ["Array", "ArrayLike", "Bool", "Float", "Int", "Key", "Num"]
