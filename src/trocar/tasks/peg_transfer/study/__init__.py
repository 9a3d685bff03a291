"""The study of the peg transfer: all variants and methods beside the paper's Tables II to IV and Figures 9 to 11."""
