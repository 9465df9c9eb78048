"""The public names of the library, each with the module that has it."""

from .agent import (
    IAC as IAC,
)
from .agent import (
    RegionSummary as RegionSummary,
)
from .agent import (
    ShadowStep as ShadowStep,
)
from .agent import (
    Step as Step,
)
from .choices import (
    Choice as Choice,
)
from .choices import (
    Greedy as Greedy,
)
from .choices import (
    Proportional as Proportional,
)
from .choices import (
    Softmax as Softmax,
)
from .config import PRESETS as PRESETS
from .config import IACConfig as IACConfig
from .drives import (
    AbsoluteProgress as AbsoluteProgress,
)
from .drives import (
    Candidates as Candidates,
)
from .drives import (
    Curriculum as Curriculum,
)
from .drives import (
    Drive as Drive,
)
from .drives import (
    Error as Error,
)
from .drives import (
    GlobalProgress as GlobalProgress,
)
from .drives import (
    Improvement as Improvement,
)
from .drives import (
    Knowledge as Knowledge,
)
from .drives import (
    MetaProgress as MetaProgress,
)
from .drives import (
    Novelty as Novelty,
)
from .drives import (
    Progress as Progress,
)
from .drives import (
    Random as Random,
)
from .drives import (
    Stage as Stage,
)
from .examples import Examples as Examples
from .experts import (
    ExpertPool as ExpertPool,
)
from .experts import (
    Experts as Experts,
)
from .experts import (
    KNNExperts as KNNExperts,
)
from .experts import (
    MLPExperts as MLPExperts,
)
from .experts import (
    NetworkExperts as NetworkExperts,
)
from .meta import ImprovementPredictor as ImprovementPredictor
from .meta import MetaPredictor as MetaPredictor
from .networks import MLP as MLP
from .progress import ErrorHistory as ErrorHistory
from .regions import (
    Cut as Cut,
)
from .regions import (
    Genealogy as Genealogy,
)
from .regions import (
    RegionTree as RegionTree,
)
from .regions import (
    Split as Split,
)
from .regions import (
    best_cut as best_cut,
)
from .reward import ProgressReward as ProgressReward
from .reward import VectorProgressReward as VectorProgressReward
from .space import Dimension as Dimension
from .space import SensorimotorSpace as SensorimotorSpace
from .state import Resumable as Resumable
from .state import Stateful as Stateful
from .version import __version__ as __version__
