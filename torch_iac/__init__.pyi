"""The public names of the library, each with the module that has it."""

from .agent import (
    IAC as IAC,
)
from .config import PRESETS as PRESETS
from .config import IACConfig as IACConfig
from .drives.baselines import Error as Error
from .drives.baselines import Improvement as Improvement
from .drives.baselines import Novelty as Novelty
from .drives.baselines import Random as Random
from .drives.choices import Choice as Choice
from .drives.choices import Greedy as Greedy
from .drives.choices import Proportional as Proportional
from .drives.choices import Softmax as Softmax
from .drives.curriculum import Curriculum as Curriculum
from .drives.curriculum import Stage as Stage
from .drives.learning_progress import AbsoluteProgress as AbsoluteProgress
from .drives.learning_progress import GlobalProgress as GlobalProgress
from .drives.learning_progress import MetaProgress as MetaProgress
from .drives.learning_progress import Progress as Progress
from .drives.protocol import Candidates as Candidates
from .drives.protocol import Drive as Drive
from .drives.protocol import Knowledge as Knowledge
from .experiment import Experiment as Experiment
from .experiment import StoppedError as StoppedError
from .experiment import load_agent as load_agent
from .experiment import load_experiment as load_experiment
from .experiment import resume as resume
from .experts.hybrid import HybridExperts as HybridExperts
from .experts.knn import KNNExperts as KNNExperts
from .experts.mlp import MLP as MLP
from .experts.network import MLPExperts as MLPExperts
from .experts.network import NetworkExperts as NetworkExperts
from .experts.protocol import ExpertPool as ExpertPool
from .experts.protocol import Experts as Experts
from .internal.state import Stateful as Stateful
from .meta_predictor import ImprovementPredictor as ImprovementPredictor
from .meta_predictor import MetaPredictor as MetaPredictor
from .records import Step as Step
from .reward import ProgressReward as ProgressReward
from .reward import VectorProgressReward as VectorProgressReward
from .runs.reader import Run as Run
from .runs.reader import load_run as load_run
from .space import Dimension as Dimension
from .space import SensorimotorSpace as SensorimotorSpace
from .training import train as train
from .version import __version__ as __version__
