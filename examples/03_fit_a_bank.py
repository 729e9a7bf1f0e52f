"""Fit a bank to pairs of frames: before and after an action, again and again.

Run it with `python examples/03_fit_a_bank.py`.  It writes the folder `my-bank`.
"""

from pathlib import Path

import jax

import jshape
from jshape.data.simulate import simulate_pairs, together


def main(folder: str | Path = "my-bank", count: int = 12, kind: str = "P") -> jshape.Bank:
    """Learn what a poke does."""
    # Your own pairs are a folder: `pairs = jshape.load_pairs("pairs")`.  These are simulated.
    pairs = together(simulate_pairs(jax.random.key(0), count, actions=["poke"]))

    # "D" is the mean difference of the paper, "P" a tool that is pressed into the bed.
    bank = jshape.fit(pairs, kind=kind)
    print(bank)
    if bank.errors_mm is not None:
        print(f"error on pairs that were held out: {float(bank.errors_mm[0]):.2f} mm")

    jshape.save_bank(bank, folder, overwrite=True)
    return jshape.load_bank(folder)


if __name__ == "__main__":
    main()
