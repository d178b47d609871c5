"""How long a tick takes: `python -m benchmark.tick`, `.growth`, `.cycle`; `.page` writes docs/benchmarks.md."""
