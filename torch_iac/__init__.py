"""Intelligent Adaptive Curiosity in PyTorch: robots that seek what they learn fastest."""

from torch_iac.agent import IAC, RegionSummary, ShadowStep, Step
from torch_iac.choices import Choice, Greedy, Proportional, Softmax
from torch_iac.config import PRESETS, IACConfig
from torch_iac.drives import (
    AbsoluteProgress,
    Candidates,
    Curriculum,
    Drive,
    Error,
    GlobalProgress,
    Improvement,
    Knowledge,
    MetaProgress,
    Novelty,
    Progress,
    Random,
    Stage,
)
from torch_iac.examples import Examples
from torch_iac.experts import ExpertPool, Experts, KNNExperts, MLPExperts, NetworkExperts
from torch_iac.meta import ImprovementPredictor, MetaPredictor
from torch_iac.networks import MLP
from torch_iac.progress import ErrorHistory
from torch_iac.regions import Cut, Genealogy, RegionTree, Split, best_cut
from torch_iac.reward import ProgressReward, VectorProgressReward
from torch_iac.space import Dimension, SensorimotorSpace
from torch_iac.state import Resumable, Stateful

__all__ = [
    "IAC",
    "MLP",
    "PRESETS",
    "AbsoluteProgress",
    "Candidates",
    "Choice",
    "Curriculum",
    "Cut",
    "Dimension",
    "Drive",
    "Error",
    "ErrorHistory",
    "Examples",
    "ExpertPool",
    "Experts",
    "Genealogy",
    "GlobalProgress",
    "Greedy",
    "IACConfig",
    "Improvement",
    "ImprovementPredictor",
    "KNNExperts",
    "Knowledge",
    "MLPExperts",
    "MetaPredictor",
    "MetaProgress",
    "NetworkExperts",
    "Novelty",
    "Progress",
    "ProgressReward",
    "Proportional",
    "Random",
    "RegionSummary",
    "RegionTree",
    "Resumable",
    "SensorimotorSpace",
    "ShadowStep",
    "Softmax",
    "Split",
    "Stage",
    "Stateful",
    "Step",
    "VectorProgressReward",
    "best_cut",
]
