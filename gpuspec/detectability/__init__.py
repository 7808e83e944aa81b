"""Probability of detection: many random defects as trials, a curve over their size, its bounds.

`curve` is what a fit is, `surface` one over two sizes, `fits` fits hits and signals, `exact` are
bounds of counts alone, `verdict` says where no model applies and how many more trials would settle
it. These take arrays. `plan`, `sizes`, `laid`, `seen`, `bench`, `folder` make trials of a station
on the workers of sweeps, `measured` reads those of others; `pod` leads through, `outcome` and
`picture` show what came out; `mapped` and `map_picture` are of a second size.
"""
