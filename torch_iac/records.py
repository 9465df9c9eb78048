"""Records that the agent returns: steps, shadows, summaries and the tree of regions."""

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class ShadowStep:
    """Predictions and errors of shadow experts at a decision.

    Attributes:
        name: Their name in the config.
        predictions: Shape `(A, K)`, in raw units.
        errors: Shape `(A,)`, float64, in scaled units.
    """

    name: str
    predictions: Tensor
    errors: Tensor


@dataclass(frozen=True)
class Step:
    """One decision of every agent and its outcome; raw units unless said otherwise.

    Attributes:
        number: Which decision, from 0.
        actions: Shape `(A, action_dim)`.
        sensors: Shape `(A, sensor_dim)`, before the action.
        outcomes: Shape `(A, K)`, what the predicted sensors read after the action.
        predictions: Shape `(A, K)`, made before learning from the outcome.
        errors: Shape `(A,)`, float64, absolute or squared as the config says, in scaled units.
        expected_errors: Shape `(A,)`, what MP expected, in scaled units; None without MP.
        regions: Shape `(A,)`, the region whose expert predicted, before any split.
        progress: Shape `(A,)`, float64, of that region when the action was chosen, in scaled units.
        random_actions: Shape `(A,)`, bool, whether the action was taken at random (epsilon).
        shadows: Predictions and errors of the shadows, in the config's order.
        used_network: Shape `(A,)`, bool, whether hybrid experts used the network; None of others.
    """

    number: int
    actions: Tensor
    sensors: Tensor
    outcomes: Tensor
    predictions: Tensor
    errors: Tensor
    expected_errors: Tensor | None
    regions: Tensor
    progress: Tensor
    random_actions: Tensor
    shadows: tuple[ShadowStep, ...]
    used_network: Tensor | None = None


@dataclass(frozen=True)
class RegionSummary:
    """The present leaves, by agent, then region; columns of shape `(leaves,)`, on the CPU.

    Attributes:
        agent: Index of the agent in the population.
        region: The region's number within its agent.
        progress: Its last learning progress, in scaled units.
        mean_error: Mean of its last `window` errors, in scaled units; NaN without any.
        n_examples: How many examples it holds.
    """

    agent: Tensor
    region: Tensor
    progress: Tensor
    mean_error: Tensor
    n_examples: Tensor


@dataclass(frozen=True)
class Genealogy:
    """Every region ever made, by agent, then region; columns of shape `(regions,)`, on the CPU.

    Attributes:
        agent: Index of the agent in the population.
        region: The region's number within its agent.
        parent: The region it came from; `NONE` for a root.
        depth: How many cuts separate it from its root.
        born_step: The decision that made it.
        split_step: The decision that split it; `NONE` for a leaf.
        cut_dimension: Which dimension of the situation it was cut along; `NONE` for a leaf.
        cut_value: Where, in the unit cube; NaN for a leaf.
        n_examples: How many examples it holds, or held when it split.
    """

    agent: Tensor
    region: Tensor
    parent: Tensor
    depth: Tensor
    born_step: Tensor
    split_step: Tensor
    cut_dimension: Tensor
    cut_value: Tensor
    n_examples: Tensor
