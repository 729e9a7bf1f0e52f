"""Durations and ratios as the tables of `distances` and `ranking` say them."""


def duration(seconds: float) -> str:
    """Three digits in the unit that suits: "115 ms"."""
    for unit, size in (("h", 3600.0), ("min", 60.0), ("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} µs"


def ratio(value: float) -> str:
    """Two digits, more are noise: "1,700", "2.4"."""
    rounded = float(f"{value:.2g}")
    return f"{rounded:,.0f}" if rounded >= 10 else f"{rounded:g}"
