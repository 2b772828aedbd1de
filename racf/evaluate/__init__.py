"""One-pass evaluation: benchmark readers, the runner, the published metrics, tables and plots.

`metrics` judges boxes against annotations; `boxfiles` and `benchmarks` read both; `trackers` builds what a name means;
`runner` runs them; `report`, `plots` and `studies` say what came out; `speed` measures.
"""
