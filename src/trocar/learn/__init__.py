"""Learning: data sets to train policies on, Gymnasium environments, and policies as agents."""
