"""Pages for a browser: of a run, of a study. Each holds its pictures in itself; nothing is asked of a network."""
