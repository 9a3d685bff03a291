"""Plans in three dimensions, in the browser."""
