"""The study of debridement: one arm and two, all methods, beside Table I of Kehoe et al. 2014."""
