"""Intelligent Adaptive Curiosity in PyTorch: robots that seek what they learn fastest."""

from torch_iac.agent import IAC, PRESETS, IACConfig, RegionSummary, Step
from torch_iac.drives import Candidates, Drive, Progress, Random
from torch_iac.examples import Examples
from torch_iac.experts import Experts, KNNExperts
from torch_iac.progress import ErrorHistory
from torch_iac.regions import Cut, Genealogy, RegionTree, best_cut
from torch_iac.space import Dimension, SensorimotorSpace

__all__ = [
    "IAC",
    "PRESETS",
    "Candidates",
    "Cut",
    "Dimension",
    "Drive",
    "ErrorHistory",
    "Examples",
    "Experts",
    "Genealogy",
    "IACConfig",
    "KNNExperts",
    "Progress",
    "Random",
    "RegionSummary",
    "RegionTree",
    "SensorimotorSpace",
    "Step",
    "best_cut",
]
