"""Benchmarks: `benchmark.tick`, `cycle`, `physics`, `nodes`, `studies`; `page` writes docs/benchmarks.md."""
