"""The vehicle against measured autopilots.  The measurements are not part of the project."""

import importlib.util
import os
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("RACF_DATA", ROOT.parent / "shared" / "data")) / "autopilot"


def fit_vehicle():
    spec = importlib.util.spec_from_file_location("fit_vehicle", ROOT / "benchmarks" / "fit_vehicle.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["fit_vehicle"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured step responses in {DATA}")
def test_the_model_is_as_close_to_each_autopilot_as_they_are_to_each_other():
    fit = fit_vehicle()
    rows = fit.judge({autopilot: fit.read(DATA / name) for autopilot, name in fit.FILES.items()})
    assert len(rows) == 18
    for label, between, px4, ardupilot in rows:
        assert ardupilot <= between, label
        # In a turn on the spot the velocity is PX4's own wandering, which no model follows; see docs/vehicle.md.
        assert px4 <= between * (1.06 if label == "yr1.5" else 1.0), label
