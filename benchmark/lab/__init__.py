"""Laboratory programs: soak, see, driver, robots."""
