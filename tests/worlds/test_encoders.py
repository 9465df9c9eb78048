"""Encoders: features of pictures, the same wherever they are made."""

from hashlib import sha256
from pathlib import Path  # noqa: F401 - no encoder, and refused as one
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces
from torch import Tensor, nn

from torch_iac import Experiment
from torch_iac.worlds.encoders import CONVOLUTION, Encoder, RandomConvolution, check_encoder
from torch_iac.worlds.spaces import Flat, encoder_maker

SHAPES = [(7, 7, 3), (3, 7, 8), (64, 64, 3), (210, 160, 3), (9, 11), (1, 1, 1)]


def picture(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, shape, np.uint8)


class Means(nn.Module):
    """The mean of each colour, of pictures as PyTorch has them, and what it was given."""

    def forward(self, pictures: Tensor) -> Tensor:
        assert pictures.dtype == torch.float32
        return pictures.mean(dim=(2, 3))


class Drawn(nn.Module):
    """Weights from PyTorch's random numbers, and layers that differ while they train."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Flatten(), nn.Dropout(0.9), nn.LazyLinear(3))

    def forward(self, pictures: Tensor) -> Tensor:
        features: Tensor = self.layers(pictures)
        return features


class Twice(nn.Module):
    def forward(self, pictures: Tensor) -> Tensor:
        return torch.cat([pictures, pictures])


class Tuples(nn.Module):
    def forward(self, pictures: Tensor) -> Any:
        return (pictures,)


class Needy(nn.Module):
    def __init__(self, size: int) -> None:
        super().__init__()
        self.size = size


made_before = Means()


def narrow() -> nn.Module:
    return nn.Sequential(nn.Conv2d(5, 1, 1), nn.Flatten())


def here(name: str) -> str:
    return f"{__name__}:{name}"


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_features_are_those_that_whole_numbers_give(shape: tuple[int, ...]) -> None:
    """The same as plain sums of whole numbers, in another order, to the bit."""
    encoder, seen = Encoder(CONVOLUTION, shape), picture(shape)
    if seen.ndim == 2:
        seen_first = seen[None]
    else:
        seen_first = seen if shape[0] < shape[2] else seen.transpose(2, 0, 1)
    module = RandomConvolution(seen_first.shape[0])
    maps = seen_first.astype(np.int64)
    for weights in (module.first, module.second):
        maps = np.maximum(convolved(maps, weights.numpy().astype(np.int64)), 0)
    _, height, width = maps.shape
    rows = [slice(height * i // 2, -(-height * (i + 1) // 2)) for i in (0, 1)]
    columns = [slice(width * i // 2, -(-width * (i + 1) // 2)) for i in (0, 1)]
    quarters = [[of[row, column].mean() for row in rows for column in columns] for of in maps]
    assert encoder(seen).tolist() == pytest.approx(np.ravel(quarters).tolist(), rel=1e-14)
    assert encoder.n_features == 32


def convolved(maps: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Convolve, three by three, every other place, with a margin of zeros, by plain sums."""
    padded = np.pad(maps, ((0, 0), (1, 1), (1, 1)))
    height, width = (-(-size // 2) for size in maps.shape[1:])
    out = np.zeros((len(weights), height, width), np.int64)
    for i in range(3):
        for j in range(3):
            seen = padded[:, i : i + 2 * height : 2, j : j + 2 * width : 2][:, :height, :width]
            out += np.einsum("oc,chw->ohw", weights[:, :, i, j], seen)
    return out


def test_the_weights_are_the_same_everywhere() -> None:
    module = RandomConvolution(3)
    signs = np.concatenate([module.first.numpy().ravel(), module.second.numpy().ravel()])
    assert set(signs) == {-1.0, 1.0}
    assert abs(signs.mean()) < 0.1
    digest = sha256(signs.astype(np.int8).tobytes()).hexdigest()
    assert digest[:16] == "4b9b308698420f31"


def test_features_tell_where_a_thing_is_and_which_colour_it_has() -> None:
    encoder = Encoder(CONVOLUTION, (64, 64, 3))

    def seen(row: int, column: int, colour: int) -> np.ndarray:
        black = np.zeros((64, 64, 3), np.uint8)
        black[row : row + 6, column : column + 6, colour] = 255
        return encoder(black)

    places = [seen(row, column, 0) for row in (8, 48) for column in (8, 48)]
    for i, one in enumerate(places):
        for other in places[:i]:
            assert np.abs(one - other).max() > 1
    assert np.abs(seen(8, 8, 0) - seen(8, 8, 1)).max() > 1


def test_a_module_of_a_users_own_gets_pictures_as_pytorch_has_them() -> None:
    for name in ("Means", "made_before"):
        encoder, seen = Encoder(here(name), (4, 5, 3)), picture((4, 5, 3))
        assert encoder(seen) == pytest.approx(seen.mean(axis=(0, 1)) / 255, rel=1e-5)
        assert encoder.n_features == 3


def test_weights_are_made_from_a_fixed_seed_and_are_frozen() -> None:
    torch.manual_seed(5)
    one = Encoder(here("Drawn"), (4, 4, 3))
    after = torch.rand(1)
    torch.manual_seed(6)
    other = Encoder(here("Drawn"), (4, 4, 3))
    seen = picture((4, 4, 3))
    assert one(seen).tolist() == other(seen).tolist() == one(seen).tolist()
    torch.manual_seed(5)
    assert torch.equal(after, torch.rand(1))  # nobody else's random numbers were drawn


def test_a_module_that_is_there_already_is_copied() -> None:
    made_before.train()
    encoder = Encoder(here("made_before"), (4, 5, 3))
    assert made_before.training
    assert encoder._module is not made_before


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("Twice", r"encoder must return a tensor of the shape \(1, features\), got \(2, 3, 4, 4\)"),
        ("Tuples", r"encoder must return a tensor of the shape \(1, features\), got tuple from"),
        ("Needy", r"encoder must be made without arguments, got .*Needy \("),
        ("narrow", r"encoder must take pictures of the shape \(1, 3, 4, 4\), got .*RuntimeError"),
        ("picture", r"encoder must be made without arguments"),
        ("SHAPES", r"encoder must be made without arguments|encoder must be or make"),
        ("Path", r"encoder must be or make a torch\.nn\.Module, got"),
        ("nobody", r"encoder must be in its module, got .*nobody, which is not"),
    ],
)
def test_what_is_no_encoder_is_refused_in_one_sentence(name: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=f"^{sentence}"):
        Encoder(here(name), (4, 4, 3))


def test_names_are_checked_before_there_is_a_picture() -> None:
    sentence = "^encoder must be convolution, pixels or module:Name, got eye$"
    with pytest.raises(ValueError, match=sentence):
        check_encoder("eye")
    with pytest.raises(ValueError, match=sentence):
        Experiment(encoder="eye")


@pytest.mark.parametrize(
    ("box", "n_features"),
    [
        (spaces.Box(0, 255, (7, 7, 3), np.uint8), 32),
        (spaces.Box(0, 255, (7, 7), np.uint8), 32),
        (spaces.Box(0, 255, (7,), np.uint8), 7),
        (spaces.Box(0, 255, (2, 7, 7, 3), np.uint8), 294),
        (spaces.Box(0, 255, (7, 7, 3), np.int64), 147),
        (spaces.Box(0, 1, (7, 7, 3), np.float32), 147),
    ],
    ids=str,
)
def test_pictures_are_boxes_of_uint8_with_two_or_three_dimensions(
    box: spaces.Box[Any], n_features: int
) -> None:
    push: spaces.Box[Any] = spaces.Box(-1, 1, (1,))
    of = Flat(push, spaces.Dict({"eye": box}), {}, encoder_maker(CONVOLUTION))
    assert len(of.sensors.names) == n_features
    if n_features == 32:
        assert of.sensors.names[3] == "eye/feature_3"
        assert Flat(push, box, {}, encoder_maker(CONVOLUTION)).sensors.names[3] == "feature_3"
        assert not np.isfinite(of.observation_space.low).any()
    assert Flat(push, box, {}, encoder_maker("pixels")).sensors.names[0].startswith("sensor_0")


def test_worlds_side_by_side_share_an_encoder() -> None:
    make = encoder_maker(here("Means"))
    assert make is not None
    assert make((4, 4, 3)) is make((4, 4, 3))
