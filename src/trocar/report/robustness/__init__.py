"""How a task's success hangs on each flaw of a laboratory."""
