"""How hard are the toy room's three zones? What can be learnt in each, and from how much.

    python -m scripts.studies.world_complexity

takes random decisions and lets offline regressors predict the next toy distance from the
action and the sensors before it, both scaled to [0, 1], zone by zone; a quarter of the decisions is
held out. It prints two Markdown tables: what each predictor leaves, and what the best one leaves
when it has seen fewer examples. `docs/worlds.md` holds a copy.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from numpy.typing import NDArray
from sklearn.dummy import DummyRegressor
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

import torch_iac_envs  # noqa: F401 - registers the worlds
from torch_iac_envs.room import ZONE_NAMES

Array = NDArray[np.float64]
Make = Callable[[], Any]
NEIGHBOURS = (1, 3, 5, 10, 20, 50)


@dataclass(frozen=True)
class Study:
    """What is measured."""

    transitions: int = 20_000
    """How many random decisions are taken."""
    seed: int = 0
    """Seeds the world, the decisions and the regressors."""
    sizes: tuple[int, ...] = (25, 50, 100, 200, 500, 1_000, 2_000, 5_000)
    """How many examples the learning curves are drawn at."""
    draws: int = 5
    """Over how many draws of the examples a point of a curve is averaged."""


@dataclass(frozen=True)
class Zone:
    """The transitions of one zone, shuffled, and split in what is learnt from and what is held out.

    Attributes:
        situations: Shape `(n, D)`, in the unit cube.
        outcomes: The next toy distance, shape `(n,)` (m).
    """

    situations: Array
    outcomes: Array
    held_out_situations: Array
    held_out_outcomes: Array


@dataclass(frozen=True)
class Error:
    """What a predictor leaves on the held-out transitions.

    Attributes:
        absolute: Mean absolute error (m).
        squared: Mean squared error (m2).
    """

    absolute: float
    squared: float


def random_transitions(n_transitions: int, seed: int) -> list[Zone]:
    """Return what random decisions lead to, one entry a zone."""
    env = gym.make("torch_iac_envs/ToyRoom-v0", disable_env_checker=True)
    outcome = env.unwrapped.metadata["sensor_names"].index("toy_distance")
    env.action_space.seed(seed)
    sensors, _ = env.reset(seed=seed)
    situations, outcomes, zones = [], [], []
    for _ in range(n_transitions):
        action = env.action_space.sample()
        scaled = _scale(action, env.action_space), _scale(sensors, env.observation_space)
        situations.append(np.concatenate(scaled))
        sensors, _, _, _, info = env.step(action)
        outcomes.append(sensors[outcome])
        zones.append(info["zone"])
    env.close()
    x, y, zone = np.array(situations), np.array(outcomes, np.float64), np.array(zones)
    draw = np.random.default_rng(seed)
    return [_split(x[zone == z], y[zone == z], draw) for z in range(len(ZONE_NAMES))]


def _scale(values: Array, box: gym.Space[Any]) -> Array:
    assert isinstance(box, gym.spaces.Box)
    return np.asarray((values - box.low) / (box.high - box.low), np.float64)


def _split(situations: Array, outcomes: Array, draw: np.random.Generator) -> Zone:
    order = draw.permutation(len(outcomes))
    learnt, held = order[len(order) // 4 :], order[: len(order) // 4]
    return Zone(situations[learnt], outcomes[learnt], situations[held], outcomes[held])


def predictors(seed: int) -> dict[str, Make]:
    """Return how to make each predictor, by name."""

    def network() -> Any:
        layers = MLPRegressor(
            hidden_layer_sizes=(128, 128),
            alpha=1e-3,
            early_stopping=True,
            n_iter_no_change=40,
            max_iter=500,
            random_state=seed,
        )
        return make_pipeline(StandardScaler(), layers)

    def trees() -> Any:
        return HistGradientBoostingRegressor(
            loss="absolute_error", learning_rate=0.05, max_iter=400, random_state=seed
        )

    neighbours: dict[str, Make] = {
        f"{k} nearest": partial(KNeighborsRegressor, n_neighbors=k) for k in NEIGHBOURS
    }
    return {"mean": DummyRegressor, "network": network, "trees": trees, **neighbours}


def error_of(make: Make, zone: Zone, seen: NDArray[np.intp] | None = None) -> Error:
    """Return what a predictor leaves that has learnt from the examples `seen`, or from all."""
    chosen = np.arange(len(zone.outcomes)) if seen is None else seen
    model = make().fit(zone.situations[chosen], zone.outcomes[chosen])
    wrong = model.predict(zone.held_out_situations) - zone.held_out_outcomes
    return Error(float(np.abs(wrong).mean()), float((wrong**2).mean()))


def print_table(errors: list[dict[str, Error]]) -> None:
    """Print what each predictor leaves in each zone, and which one leaves least."""
    heads = [f"{zone} {kind}" for zone in ZONE_NAMES for kind in ("absolute (m)", "squared (m2)")]
    print("| predictor | " + " | ".join(heads) + " |\n" + "|---" * (len(heads) + 1) + "|")
    for name in errors[0]:
        cells = [f"{zone[name].absolute:.4f} | {zone[name].squared:.5f}" for zone in errors]
        print(f"| {name} | " + " | ".join(cells) + " |")
    print()
    for zone, name in zip(errors, ZONE_NAMES, strict=True):
        best = best_of(zone)
        print(f"- {name}: {best} leaves {zone[best].absolute:.4f} m,", end=" ")
        print(f"{zone[best].absolute / zone['mean'].absolute:.1%} of what the mean leaves.")


def best_of(errors: dict[str, Error]) -> str:
    """Return the name of the predictor with the least absolute error."""
    return min(errors, key=lambda name: errors[name].absolute)


def curve(zone: Zone, study: Study) -> list[float]:
    """Return the least absolute error that any predictor reaches from so many examples (m)."""
    draw = np.random.default_rng(study.seed)
    points = []
    for size in study.sizes:
        draws = [draw.permutation(len(zone.outcomes))[:size] for _ in range(study.draws)]
        makes = [m for n, m in predictors(study.seed).items() if not _needs_more(n, size)]
        means = [np.mean([error_of(m, zone, seen).absolute for seen in draws]) for m in makes]
        points.append(float(min(means)))
    return points


def _needs_more(name: str, n_examples: int) -> bool:
    return name.endswith("nearest") and int(name.split()[0]) > n_examples


def print_curves(curves: list[list[float]], floors: list[float], sizes: tuple[int, ...]) -> None:
    """Print the curves, in metres and as multiples of what is left in the end."""
    print("\n| examples | " + " | ".join(ZONE_NAMES) + " |\n" + "|---" * (len(curves) + 1) + "|")
    for row, size in enumerate(sizes):
        cells = [
            f"{points[row]:.4f} ({points[row] / floor:.1f} x)"
            for points, floor in zip(curves, floors, strict=True)
        ]
        print(f"| {size} | " + " | ".join(cells) + " |")


def main(study: Study) -> None:
    """Print both tables."""
    warnings.simplefilter("ignore", ConvergenceWarning)
    zones = random_transitions(study.transitions, study.seed)
    makes = predictors(study.seed)
    errors = [{name: error_of(make, zone) for name, make in makes.items()} for zone in zones]
    print_table(errors)
    floors = [zone[best_of(zone)].absolute for zone in errors]
    print_curves([curve(zone, study) for zone in zones], floors, study.sizes)


if __name__ == "__main__":
    main(tyro.cli(Study, description=__doc__))
