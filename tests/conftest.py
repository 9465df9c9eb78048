"""What the tests share: small spaces, a small world, and one thread."""

import matplotlib.font_manager  # noqa: F401 - says so where it has no cache yet, and not in a test
import pytest
import torch
from hypothesis import settings

from torch_iac import Dimension, SensorimotorSpace

torch.set_num_threads(1)
settings.register_profile("untimed", deadline=None)  # how fast the machine is decides no test
settings.load_profile("untimed")


@pytest.fixture
def space() -> SensorimotorSpace:
    """Two actions, two sensors, the second of which is predicted; all in different units."""
    near, far = Dimension("near", 0.0, 2.0), Dimension("far", -1.0, 3.0)
    return SensorimotorSpace(
        actions=(Dimension("push", -1.0, 1.0), Dimension("tone", 0.0, 10.0)),
        sensors=(near, far),
        outcomes=(far,),
    )
