"""The published figures of four benchmarks, from the authors' own boxes (skipped where these are not at hand)."""

import os
from pathlib import Path

import pytest

from racf.evaluate.benchmarks import read_benchmark
from racf.evaluate.report import build_report
from racf.evaluate.stored import read_stored, trackers_in

DATA = Path(os.environ.get("RACF_DATA", Path(__file__).parents[3] / "shared" / "data"))
PAPER = DATA / "paper"

# Precision at 20 px and AUC in the toolkit convention: Table 2 and figure 3 of the paper to one decimal.
PUBLISHED = {
    "DTB70": {"RACF": (72.52, 50.48), "AutoTrack": (71.61, 47.82), "ARCF-HC": (69.41, 47.18), "STRCF": (64.92, 43.71),
              "CSRDCF": (64.65, 43.85), "ECO-HC": (63.53, 44.75), "MCCT-H": (60.35, 40.53), "BACF": (58.15, 39.79),
              "fDSST": (53.41, 35.68), "SAMF": (51.89, 33.89), "Staple-CA": (50.38, 35.10), "KCF": (46.75, 28.00),
              "DSST": (46.29, 32.11), "KCC": (44.02, 29.10)},
    "UAVDT": {"RACF": (77.25, 49.43), "AutoTrack": (71.84, 44.95), "ARCF-HC": (71.97, 45.75), "STRCF": (62.89, 41.13),
              "CSRDCF": (67.40, 38.89), "ECO-HC": (69.43, 41.55), "MCCT-H": (66.75, 40.23), "BACF": (68.64, 43.16),
              "fDSST": (66.59, 38.33), "SAMF": (58.61, 31.29), "Staple-CA": (69.53, 39.36), "KCF": (57.05, 29.00),
              "DSST": (68.14, 39.19), "KCC": (64.87, 38.86)},
    "UAV123_10fps": {"RACF": (69.43, 48.57)},
    "VisDrone2018-SOT-test-dev": {"RACF": (83.41, 59.99)},
}  # fmt: skip


@pytest.mark.skipif(not PAPER.is_dir(), reason=f"the benchmarks' annotations and stored boxes are missing: {PAPER}")
@pytest.mark.parametrize("benchmark", PUBLISHED)
def test_stored_boxes_give_the_published_figures(benchmark):
    sequences = read_benchmark("folder", PAPER / benchmark)
    results = PAPER / benchmark / "results"
    names = trackers_in(results, sequences)
    assert set(names) == set(PUBLISHED[benchmark])
    report = build_report(sequences, {}, {name: read_stored(results, name, sequences) for name in names})
    assert len(report.counted) == len(sequences)
    for name, figures in report.as_json().items():
        assert (figures["precision_20px"], figures["auc"]) == pytest.approx(PUBLISHED[benchmark][name], abs=0.01)


NINE = DATA / "results"
OFFICIAL = {"RACF": (89.4, 59.3), "AutoTrack": (91.8, 60.1), "ARCF-HC": (82.7, 55.7), "BACF": (65.8, 38.8)}


@pytest.mark.skipif(not NINE.is_dir(), reason=f"the nine sequences and their stored boxes are missing: {NINE}")
def test_the_nine_sequences_have_their_official_figures_and_the_tenth_stays_outside_the_mean():
    sequences = read_benchmark("folder", DATA)
    stored = {name: read_stored(NINE, name, sequences) for name in OFFICIAL}
    report = build_report(sequences, {}, stored)
    assert len(report.counted) == 9
    assert "Biker" not in report.counted
    for name, figures in report.as_json().items():
        assert (figures["precision_20px"], figures["auc"]) == pytest.approx(OFFICIAL[name], abs=0.05)
