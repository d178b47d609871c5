"""What a tick costs: `python -m benchmark.tick`, `.growth`, `.cycle`, `.nodes`; `.page` writes docs/benchmarks.md."""
