"""Files: archives of arrays, checked reading, writing in one step, CSV."""
