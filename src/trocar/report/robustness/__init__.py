"""How a task's success depends on each flaw of a laboratory."""
