"""Square root, cosine, sine and logarithm of tensors, with the same bits on every processor.

PyTorch leaves these functions to libraries that choose their instructions by processor and setting,
and round differently with each. Here they are made of additions, subtractions and multiplications,
of divisions, comparisons and the numbers' bits alone: IEEE 754 says what each of these gives, to
the last bit. Results have the type of the argument, float32 or float64.
"""

import math

import torch
from torch import Tensor

TAU_PARTS = (6.28125, 0.0019350051879882812, 3.019915981956753e-07)
"""2 pi in three parts, the first two of 8 and 11 bits: in float32 too, up to 8,192 turns times one
of them is exact."""
SINE = (
    1.0,
    -0.16666666666666666,
    0.008333333333333186,
    -0.00019841269841208676,
    2.7557319211229606e-06,
    -2.505210689056952e-08,
    1.605894087848656e-10,
    -7.643026557971632e-13,
    2.7215749422983443e-15,
)
"""sin(x) / x as a polynomial in x**2 up to x = pi / 2, met at Chebyshev's points: 2e-17 off."""
AREA_TANGENT = (
    1.0,
    0.33333333333333826,
    0.1999999999965117,
    0.1428571438032084,
    0.11111098528363024,
    0.09091815840114664,
    0.07656264074182095,
    0.07404855180327638,
)
"""artanh(x) / x likewise, up to x = 0.172: 4e-18 off."""
LOG_2_PARTS = (0.6931471803691238, 1.9082149292705877e-10)
"""ln 2 in two parts, the first of 32 bits, so that an exponent times it is exact."""

SQRT_HALF_BITS = 0x3FE6A09E667F3BCD
"""The bits of sqrt(1 / 2) in float64."""
ROOT_GUESS = 0x5FE6EB50C7B537A9
"""Less half a number's bits, it is the bits of 1 / root of that number, to 3.5 %.

Source: Lomont (2003), Fast inverse square root.
"""
ROOT_STEPS = 3
"""Newton's steps, from an error of 3.5 % to one of 5e-11; a last step makes it that of float64."""
FRACTION_BITS = 52
"""Of a float64."""


def circle(angle: Tensor) -> Tensor:
    """Return cosine and sine of an angle (rad), stacked, shape `(2, *angle.shape)`.

    Up to 50,000 rad, a float64 is off by less than 5e-16, a float32 by less than 3e-7.
    """
    turns = (angle * (1 / math.tau)).round_()
    turned = angle
    for part in TAU_PARTS:
        turned = turned - turns * part
    # Both are sines of an angle in [-pi / 2, pi / 2].
    quarter = math.pi / 2
    folded = turned.clamp(-quarter, quarter).mul_(2).sub_(turned)
    folded = torch.stack([quarter - turned.abs_(), folded])
    return _series(SINE, folded * folded).mul_(folded)


def root(number: Tensor) -> Tensor:
    """Return the square root of finite numbers that are not negative, of their shape.

    A float32 is rounded correctly; a float64 is off by its last bit at most.
    """
    exact = number.double()
    inverse = (ROOT_GUESS - (exact.view(torch.int64) >> 1)).view(torch.float64)
    half = 0.5 * exact
    for _ in range(ROOT_STEPS):
        inverse = inverse * (1.5 - half * inverse * inverse)
    guess = exact * inverse
    return (guess + 0.5 * inverse * (exact - guess * guess)).to(number.dtype)


def logarithm(number: Tensor) -> Tensor:
    """Return the natural logarithm of positive, finite, normal numbers, of their shape.

    Off by less than 3e-16 times the larger of itself and 1, if they are float64.
    """
    bits = number.double().view(torch.int64)
    power = (bits - SQRT_HALF_BITS) >> FRACTION_BITS
    part = (bits - (power << FRACTION_BITS)).view(torch.float64)  # in [sqrt(1 / 2), sqrt(2))
    exponent = power.double()
    ratio = (part - 1) / (part + 1)
    high, low = LOG_2_PARTS
    rest = exponent * low + 2 * ratio * _series(AREA_TANGENT, ratio * ratio)
    return (exponent * high + rest).to(number.dtype)


def _series(coefficients: tuple[float, ...], x: Tensor) -> Tensor:
    """Return the sum of `coefficients[n] * x**n`."""
    total = x * coefficients[-1]
    for coefficient in coefficients[-2:0:-1]:
        total.add_(coefficient).mul_(x)
    return total.add_(coefficients[0])
