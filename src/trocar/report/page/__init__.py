"""Pages for a browser: of a run, of a study. Each includes its pictures; nothing is loaded from a network."""
