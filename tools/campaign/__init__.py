"""Many flights of one experiment: planned, flown on all cores or machines, told as a table."""
