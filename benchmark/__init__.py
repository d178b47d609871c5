"""What things cost: `benchmark.tick`, `cycle`, `physics`, `nodes`, `studies`; `page` writes docs/benchmarks.md."""
