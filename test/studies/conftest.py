"""A small study."""

import pytest
from study_files import SHORT, write


@pytest.fixture
def small(tmp_path):
    vary = "vary: {gait.step_length: {from: 0.01, to: 0.03, steps: 3}, dsp.flat_feet: [true, false]}\n"
    return write(tmp_path / "small.yaml", SHORT + vary)
