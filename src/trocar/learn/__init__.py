"""Learning: data sets that policies are trained on."""
