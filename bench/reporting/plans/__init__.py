"""Pages of tests that are planned, and of what each method is expected to do at one."""
