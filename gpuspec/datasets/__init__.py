"""Data sets to train and test detectors on: images of many random parts, masks, annotations.

`draws` says what is drawn for a part, `plan` which part is which, `sample` makes one of them, `rle`
and `coco` write what is known of it, `folder` keeps them, `dataset` goes the way; `sheet`,
`contact` and `histograms` are its data sheet. Imports `simulation`, `sweeps` and what stands below.
"""
