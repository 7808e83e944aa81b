"""Every tolerance of the tests, with its unit and the measured reason for it.

Measured: the worst case over eight-wide and scalar REAL, PoCL 3.0 on an x86 CPU. The room above it
is for devices that round otherwise (fused multiply-add, their own exp and sin).
"""

from __future__ import annotations

# ------------------------------------------------------------------------------ device functions

FLOAT_ROUNDING = 2.0**-23
"""Relative: the last bit of a float. Measured 0.5 bits where one sum rounds once."""

SUM = 3e-7
"""Relative: three roundings of positive terms; measured 1.0e-7."""

VECTOR = 1e-6
"""Components of vectors below 4, and lengths of reflected unit vectors, themselves units to
3e-8 per component only; measured 5.6e-7."""

CROWN = 5e-7
"""Relative: height, slope and curvature of a crown from 150 mm up; measured 1.8e-7."""

SLOPE_DIFFERENCE = 5e-8
"""Slope by central differences over 2e-3 mm; truncation 1e-9, measured 1e-8 with `CROWN`."""

CURVE_DIFFERENCE = 5e-8
"""1/mm, second difference over 1e-3 mm of heights of 40 mm in float64; measured 1e-8."""

POINT = 3e-7
"""Relative to piece and offset: the nearest point's place, and its direction; measured 7e-8."""

GROOVE = 4e-7
"""Height, slope, curvature in units of depth / sigma^n, times 1 + offset / sigma (the distance is a
difference of offsets); measured 1.1e-7."""

GROOVES_MM = 4e-8
"""mm: height of crossing grooves up to 0.03 mm deep; over their sigma, their slope."""

SPLINE = 1e-6
"""Weights up to 3 and their sums, u from -0.5 to 1.5; measured 3.3e-7."""

DERIVATIVE = 2e-6
"""Derivatives of vectors of length near 1 against central differences; measured 4.4e-7."""

HEIGHT_MM = 2e-5
"""mm: where a ray meets a plane after one Newton step, or a crown of 40 mm radius at 25 mm (slope
0.8) after three steps; measured 8.2e-6, of heights to 40 mm with a last bit of 4e-6."""

NEWTON = 5e-4
"""Of a footprint: light coordinates on the steepest height surfaces that a ray can meet only once;
one Newton step leaves 0.11, 0.11 and 0.06, two 2.1e-4, 9e-5 and 1.2e-4."""

NEWTON_TWICE = 1e-4
"""The same where a ray may meet the part twice; measured 1.5e-5 at most after three or more."""

HIT = 3e-7
"""Relative to the path and the tunnel: distance of a hit from tunnel's wall; measured 6.7e-8."""

REFLECTANCE = 4e-6
"""Reflectance, 0 to 1, times cos^4: the formula cancels at grazing incidence; measured 8.9e-7."""

SIGHT_MM = 1e-4
"""mm on the light, over the squared cosine of the reflected ray: paths of 200 mm, slopes with a
last bit of 6e-8; measured 1.6e-5. Borders within it are taken for either side."""

FOOTPRINT = 5e-5
"""Relative, plus 1 % of it over the squared cosine of the reflected ray: central differences of the
exact light coordinate over 2e-3 mm; measured 1.1e-5."""

TWO_BOXES = 2e-6
"""Relative: variance and fourth cumulant of a footprint's two boxes, of squares and roots in
float32."""

LIGHT_ROUNDING = 2.0**-23
"""Relative: the place of a footprint's ends on the light, in periods. It is worth this / footprint
of lit fraction: 1e-5 periods cannot be placed better than to 40 % at 30 periods from the origin,
and that is why the laws on small footprints are laws of means."""

LIT = 6e-7
"""Lit fraction beyond `LIGHT_ROUNDING`; measured 2.5e-7."""

BERNOULLI = 1e-6
"""Of Bernoulli's polynomials, below 1/6."""

KINKS = 2
"""Times a kink's rounded place: what a mean over a scan of K images is off for it, over the width
of the footprint and K; measured 0.7. A footprint of 1e-5 periods is worth 1 DN at gain 4 and one
image."""

SCAN = 8e-7
"""Of the exposure before saturation, beyond `LIGHT_ROUNDING`: the mean over a scan; what
saturation cuts off leaves its rounding (gain 100: 2e-5 of full scale, 1 DN in 16 bits); measured
1.7e-7."""

NORMAL = 6e-6
"""Normal numbers: the angle 2 pi u is known to 2.4e-7, times a radius to 5.8; measured 1.4e-6."""

LOG_NEAR_ONE = 2.0**-21
"""Absolute: GLSL 4.60, 4.7.1, lets log2 be so far off from 0.5 to 2. A normal number r near 0 then
errs by it / r; a quarter of that measured on llvmpipe, 1.1e-4 at r = 3.5e-4."""

POISSON_STEP = 1e-6
"""Probability: a float sum of the distribution function may pass a uniform number so much too early
or late; 44 roundings of a sum below 1, measured 2.4e-7 over all 2^23."""

POISSON_STEPS = 8
"""Of 2^23 uniform numbers, those that fall on the wrong side of one step; measured 2."""

ROUNDING_FLIPS = 1e-3
"""Share of grey levels where one electron more or less, for a number that lies within float
rounding of a half, shows; all bit depths, signals to 75,000 electrons; measured 1.3e-4."""

# ------------------------------------------------------------------------------------------ noise

P_VALUE = 1e-4
"""A chi-square or Kolmogorov-Smirnov test fails below it. Seeds are fixed: no false alarm."""

SIGMAS = 4.5
"""Standard deviations of an estimate, p = 7e-6 two-sided. Of 1,048,576 numbers it resolves 0.4 % of
a standard deviation and, for variances, 0.6 %."""

FLAT_FLIPS = 2e-3
"""Share of pixels one DN apart between float and float64 on a flat field in 12 bits (one electron
is 0.39 DN): electrons or grey level within rounding of a half; measured 1.1e-3 at most, where the
lit fraction's last bit is a thousandth of an electron."""

STRIPED_FLIPS = 2e-3
"""The same under stripes, where the light coordinate's rounding adds; measured 3.6e-4."""

STRIPED_FLIP_DN = 1
"""DN: never more than one; measured 1."""

POISSON_MOMENTS = 2e-4
"""Relative: mean and variance of rounded Gaussian electrons over 2^20 quantiles; measured 5.3e-5.
Rounding alone would add 1/12, which is 5.2e-3 of 16 and 8.3e-4 of 100."""

# ------------------------------------------------------------------------------------------- EMVA

EMVA_GAIN = 0.005
"""Relative: K and quantum efficiency; 38 variances of 36,864 pixels, each to 0.5 %, fit to 0.15 %.
Measured 0.17 %."""

EMVA_DARK_NOISE = 0.01
"""Relative: one dark pair, 0.26 %, and K; measured 0.43 %."""

EMVA_BLACK_DN = 0.2
"""DN: mean of 36,864 pixels of dark noise 8.5 and DSNU 2.4 DN; measured 0.016."""

EMVA_CAPACITY = 0.045
"""Relative: the point of largest variance lies 2 to 4 of its 100 electrons (1 %) below, in steps of
2 %; measured 3.3 %."""

EMVA_LINEARITY_PERCENT = 0.1
"""Percent of the signal; measured 0.02."""

EMVA_PATTERN = 0.02
"""Relative: DSNU and PRNU, rms over 36,864 pixels (0.4 %) after 16 images each; measured 0.4 %."""

# ----------------------------------------------------------- placement, relief, truth, inspection

PLACED_MM = 1e-8
"""mm: the frozen coordinates have nine digits; cosines and cumulative sums of 50 mm round to 1e-14.
Also the share of a distribution, which its quantile function gives back to 1e-13."""

DRAWN_FROM = 0.01
"""Least p of a Kolmogorov-Smirnov test at a fixed seed; measured 0.39 to 0.76."""

RECORD_PX = 1e-6
"""px: a record keeps the fraction of a pixel apart, to a float's half last bit, 6e-8.
Measured 1e-8, asked for 1e-6."""

VOLUME = 1e-9
"""Relative: volume of an averaged groove summed over a grid far finer than it; measured 2e-16."""

ZONE_AREA = 0.01
"""Relative: pixels of a zone against pi r^2 / p^2, for zones of 5,000 pixels; measured 0.06
to 0.2 %; a quarter of one at the corner of the image, allowed three times this: 0.6 %."""

# ------------------------------------------------------------- aspect images against the oracle

# The model's check scenes; measured 0.265 and 3.73, with automatic sub-rays, on other scenes too,
# 0.066 and 0.30, as with 8 x 8 everywhere: the lens' disc as two boxes, and the oracle's noise.
ONE_FOOTPRINT_RMS_DN = 0.30
ONE_FOOTPRINT_MAX_DN = 4.5
# Asked for on flat parts seen by random lenses; measured 0.12, one box of the same variance 0.73.
LENS_RMS_DN = 0.25
AUTOMATIC_RMS_DN = 0.10
AUTOMATIC_MAX_DN = 0.60
# One pixel across the bend of a scratch, a crease; measured 1.04, with one footprint 14.8.
CREASE_MAX_DN = 2.0
# Automatic sub-rays of a pinhole, 12 images, exposure 6: from 8 x 8 for every pixel. Measured 0.005
# at pixels left at one footprint; of all pixels rms 0.016 and at most 0.58, one footprint 48.
LEFT_AT_ONE_FOOTPRINT_DN = 0.05
REFINED_RMS_DN = 0.05
REFINED_MAX_DN = 1.2
# Tables of footprints, from every sub-ray in every image. Measured 0.0014 and 0.055.
FOOTPRINT_RMS_DN = 0.004
FOOTPRINT_MAX_DN = 0.15
# Noise of refined pixels, from a float64 sum over their images. Measured 0.0016 and 0.0093.
REFINED_MEAN_DN = 0.005
REFINED_DEVIATION = 0.02
# Spread of 40 draws of some 900 pixels. Measured 0.007, of which 1/80 is that of 40.
DRAWN_SPREAD = 0.03
# The same images added up in another order. Measured 2e-5.
SAME_IMAGES_DN = 1e-4
# Two boxes for the Gaussian of roughness, on flawless pixels too; measured 0.474 and 0.75.
ROUGH_RMS_DN = 0.60
ROUGH_MAX_DN = 1.0
# The table is rounded to 0.1, measured 0.025 off; the maximum is one pixel's, measured 0.65 off:
# the table's own sampling, of which the oracle differs by 0.08 from itself with 16,384 rays.
TABLE_MEDIAN_DN = 0.05
TABLE_MAXIMUM_DN = 0.7

# ------------------------------------------------------------------- whole images, float32 to 64

# OpenCL against float64: asked for 0.02 DN of 255. Measured: 0.002 for the mean (a float's last
# bit of a light coordinate of 100 mm, over a footprint of 0.1 mm, in one image of 40), 0.05 for one
# image on the flank of a stripe.
DEVICE_DN = 0.02
IMAGE_DN = 0.1
LIGHT_MM = 5e-4
FOOTPRINT_SHARE = 1e-3
LOST_FLIPS = 4
CREASE_FLIPS = 4

# ------------------------------------------------------------------------------------------ laws

# A footprint of 2.4e-4 mm beside a step of 1 mm: one image in 16 differs for 1 pixel in 4,000.
POINT_SAMPLED_DN = 0.02
EQUAL_MEAN_DN = 0.002
# A place two periods on is rounded to 1.2e-7 of a period; times 765 DN over a footprint of some
# 0.05 periods. Measured 0.0021.
SHIFTED_DN = 0.005
# Pixels of 0.004 sigma at two edges; the table has three digits; obliquity of the camera ray.
SIGNATURE_WIDTH = 0.02
SYMMETRY_MM = 2e-4

HANDBOOK_PERCENT = 1.0
"""Percent: reflectances of metals near 550 nm as handbooks print them, rounded; measured 0.5."""

CHANCE_SHARE = 0.05
"""Relative: share of pixels above their own quantile, some of which are
equal; measured 2 %."""

SEEN_POINT_MM = 1e-9
"""mm: the point behind a pixel, by Newton's method in float64; measured 7e-15."""

SCALED_SHARE = 1e-6
"""Relative: grey levels of 10, 12 and 16 bits against those of 8, in float32; measured 4e-8."""

THRESHOLD_DN = 0.06
"""DN: pixels so near to the threshold may be detected by one backend only. Measured 0.003
between backends, and 0.025 with noise: one image in 40 rounded the other way; twice is allowed."""

EXPOSED_RAY = 5e-5
"""Of saturation, at gain 6: a light coordinate of 30 periods rounded to float, over a footprint of
a hundredth of a period; measured 1.6e-5."""

# --------------------------------------------------------------------------------------- studies

SIGNATURE_DIGITS = 0.005
"""Sigmas: the model's table of widths has two or three digits; measured 0.004 off 0.25."""

SIGNATURE_IMAGES = 0.02
"""Sigmas: width in the images against the closed form; pixels of 0.004 sigma at two edges, and the
camera ray aslant. Measured 0.008 on all four backends, 0.004 on crowns of 300 and 2000 mm."""

LIGHT_POINT = 0.02
"""Relative: greatest movement of the light point against the closed form, the camera from 4 m up
and the dent 100 mm off the axis; measured 0.8 % by slope (slopes up to 0.07), 0.1 % by height."""

GRADIENT = 2e-6
"""Relative: the scale of a flat part from the footprint of a pinhole, in float32; measured 1.8e-7.
"""

DISTANCE_MM = 2e-4
"""mm on the light: distance to a transition, from light coordinates of 150 mm in float32; measured
7e-5 against float64 on a crown, 1.8e-5 on a flat part."""

# ---------------------------------------------------------------------------------------- sweeps

WRONG_SWEEPS = 0.01
"""Share of screened sweeps with any wrong bound, as promised. Measured on made-up ones of 16
designs: none of 300 (bounds of neighbouring thresholds go together); at a confidence of 50 %, 7 %.
"""

TABLE_SHARE = 0.05
"""Of the disk that is asked for before a sweep: a small table compresses;
measured 0.12 and 0.13."""

BOUND = 1e-9
"""Relative: Clopper and Pearson's interval against scipy's; measured 1e-12."""

BOUND_STEP = 3e-3
"""Of all pixels: what a bound of 5,000 strata is wider for not being worked out number by number;
measured 1.9e-3."""

RISK = 1e-6
"""Relative: chance of a bound to be wrong against its share; measured 1e-9 (the inverse of the
distribution function in float64)."""

# ------------------------------------------------------------------------- measured topographies

MAP_PITCH = 2e-7
"""Relative: pitches, and sizes and places from them, as files hold them in float32; measured
8.2e-8."""

MAP_SLOPE = 5e-7
"""Slopes of the float32 spline against float64: heights of 1 um are rounded to 6e-8 of themselves
over a pitch of 4 um; measured 2.3e-7."""

MAP_SEEN_MM = 3e-4
"""mm: the same as light coordinate, of a swing of 31 mm; measured 1.0e-4."""

MAP_LIGHT_MM = 5e-4
"""mm: light coordinate of a pit sampled at a tenth of its sigma against the dent's formula, of a
swing of 9.7 mm; measured 1.5e-4."""

MAP_FOOTPRINT = 5e-3
"""Of the largest footprint: the same, by the cubic spline's curvature; measured 2.6e-3."""

MAP_SMOOTHED_MM = 1e-6
"""mm: the Gaussian on the grid against the true one, of a pit of 1 um; measured 6.5e-7."""

MAP_SOLVED_MM = 1e-15
"""mm: a spline through heights of 0.01 mm, a plane fitted and a hole of a saddle filled, in
float64; measured 1.1e-17."""

MAP_SLOPE_DIFFERENCE = 1e-8
"""Central differences over 2e-6 mm of heights of 0.01 mm in float64; measured 7.6e-10."""

MAP_CURVE_DIFFERENCE = 1e-6
"""1/mm: the same of slopes; measured 9.8e-8."""

MAP_TILT = 2e-9
"""Slope of a tilted plane whose heights are rounded to 1e-8 mm; measured 1.6e-10."""

MAP_TILT_SEEN_MM = 1e-4
"""mm: its light coordinate, moved by 0.48 mm, in float32; measured 1.2e-5."""

MAP_FILLED_MM = 1e-6
"""mm: a hole of 3 x 3 points in a wavy surface of 2e-5 mm, filled; measured 3.1e-7."""

MAP_RECORD_PX = 1e-5
"""px: a map's corner 100 px from the origin, of a pitch in float32; measured 2.8e-6."""

# ------------------------------------------------------------------------------------- the oracle

EXACT = 1e-11
"""Absolute, mm, unitless or DN: float64 round-off of values below 1000; measured 6e-14."""

ORACLE_SLOPE_MM = 2e-5
"""mm on the light: central differences against derivatives, 1.4e-5 by the estimate in
`oracle.slopes`; measured 6.1e-6 for a dent, 4e-8 for a crown."""

RAYS_MM = 1e-3
"""mm on the light: mean and reach of 4,096 rays spread over a pixel; measured 4.3e-5."""

PUPIL_RMS = 1e-3
"""Relative: rms of 4,096 rays spread over a disk; measured 1.5e-5."""

PUPIL_EDGE = 5e-3
"""Relative: the outermost of them; measured 1.5e-3."""

ROUGH_RMS = 1e-3
"""Relative: rms of rays spread by a Gaussian; measured 7.4e-5."""

ROUGH_KURTOSIS = 5e-3
"""Relative: their kurtosis; measured 1.8e-3."""

SECOND_ORDER = 1e-8
"""DN of 1: a bump's signature against a dent's, which differ by the square of a slope of 1e-5;
measured 2.7e-10."""

# --------------------------------------------------------------------------------- blobs, pictures

BLOB = 1e-9
"""Relative and mm: float64 sums over a few hundred pixels; measured 4.6e-15."""

BLOB_ANGLE = 1e-6
"""rad: angles from differences of variances, which lose some digits; measured 4.9e-15."""

NINE_DIGITS = 1e-8
"""Relative: a table of nine significant digits; measured 4.0e-9."""

FOUR_DIGITS = 1e-3
"""Relative: sizes and depths are written with four significant digits; measured 1.3e-4."""

PLACES = 1e-4
"""mm: places are written with four decimals."""

THRESHOLD_STEP_DN = 0.125
"""DN: an automatic threshold is rounded up to a whole step of it; measured 0.093."""

SHOWN_DN = 4.5
"""DN: means of 255 shown in 64 colours of 4 DN, and half a DN; measured 3.9."""

POOLED = 1e-6
"""Relative: means of neighbouring pixels in float32; measured below 1e-7."""

TO_SCALE = 1e-6
"""Relative: a picture's two scales; measured 5.4e-16."""

PNG_DN = 1.0
"""DN: grey levels are cut to whole ones; measured 0.99."""

PIT_DEPTH = 0.1
"""Relative: the deepest of the points of a pit of 0.6 points' sigma, away from its centre; measured
6.1 %."""

PIT_SIZE_PITCHES = 0.5
"""Pitches: diameter of a pit from its number of points; measured 0.18."""

FLAWLESS_DN = 1.0
"""DN: the flawless level where half of the part is dark, against the whole part's; measured 0."""

PRINTED_BOUND = 1e-4
"""Intervals as tables print them, to four decimals."""

FORCE = 0.05
"""A dent's strength, printed as 28.4; measured 0.044 off."""

FOLD = 1e-6
"""Sigmas: where a signature begins, found by halving; measured 1.3e-8."""

FALLS_WITH_DISTANCE = 1e-3
"""Relative: movement by height against one over the camera's distance; measured 8.8e-5."""

CROWN_MOVED = 0.1
"""Relative: movement of the light point by a crown against first order; measured 6.7 %."""

EDGE_MM = 1e-12
"""mm: distance to a transition in float64; measured 0 to the last bit."""

OPENING_AREA = 0.02
"""Relative: pixels that reflect the opening against its area, cut by pixels; measured 0.6 %."""

BACKEND_P2 = 0.02
"""P2 of one defect on two backends: one of its 50 pixels on the threshold; measured 0."""

LEVELS_OFF = 1e-3
"""Relative: what the greatest movement by slope still changes between far cameras; measured 2.6e-4.
"""

SMALL_ZONE_AREA = 0.2
"""Relative: pixels of zones of 20 to 80 pixels against their circles; measured 11 %."""

STEP_OFF = 2.0**-23
"""Of full scale: thresholds in float32 against equal steps; measured 2.8e-8."""

MEAN_ESTIMATE = 5e-3
"""Of the pixels of the part: mean of 40 estimates by samples of 700; measured 1.9e-3."""

BUMP_DENT = 2e-4
"""Of the light coordinate: what bump and dent deflect beside opposite amounts; measured 3.9e-5."""

PATTERN_FLIPS = 1e-3
"""Share of pixels where a rounded sum turns an electron, and so a grey level of one image; measured
0 of 1,024."""

WARPED_FLIPS = 1e-3
"""Share of pixels where warped stripes of a flat part are not the stripes; measured 0."""

WARPED_TIMES, WARPED_S = 8, 0.02
"""Times a simple pattern's, and seconds: measured on llvmpipe and lavapipe 2 to 4 times; with
trigonometry in each step 30 to 40."""

# ----------------------------------------------------------------------------- noise in closed form

NORMAL = 2e-5
"""Of a normal number: sine and logarithm in float32, up to 5.8; measured 5e-6."""
CELL = 1e-4
"""Of a made table whose cells rise by 1: a place of up to 800 is rounded to 6e-5."""
MOMENTS_DN = 0.01
MOMENTS_VARIANCE = 4e-6
"""Of one image: grey levels of 16 bits, and a variance of products, in float32."""
CLIPPED_MEAN = 0.0025
"""What `clipped_mean` says it is within, and float32."""
CLIPPED_VARIANCE = 0.0225
"""What `clipped_variance` and `clipped_below` say they are within, and float32."""
COUNTED = 1e-3
"""Of a number of images up to 60."""
SIDES = 1e-5
"""Of a plateau, relative: sums of a side's rise in float32."""
QUIET_DN = 0.02
"""Of 4095 grey levels: the closed form twice in float32, and a spread of 3e-5."""
NOISY_BIAS_DN = 0.01
"""Of 255, on average over a part: measured 0.004 and less."""
NOISY_MEAN_DN = 0.05
"""Of 255, of any pixel: what noise in closed form is meant to reach."""
NOISY_DEVIATION = 0.05
"""Of the standard deviation, likewise."""
NOISY_TABLE_DN = 0.03
"""Cells are linear; Poisson numbers from 16 electrons on are normal and whole, and not so here."""
NOISY_BEYOND = 0.04
"""Share of pixels further off than those two, of 20 random stations: measured 0.5 % over many, and
2.6 % where all pixels of one are in the same place of their stripes."""
NOISY_WORST_DN = 0.5
"""Of those, the worst: at 100 to 300 electrons; measured 0.25."""
NOISY_DRAW_DN = 0.1
"""Of one draw between backends: mean, and 5 % of a deviation of 0.3 times a normal number."""
NOISY_SHARE = 0.003
"""Of P1 and P2, likewise: what noise in closed form is meant to reach."""

# ------------------------------------------------------------------------------ profiles of a light

PROFILE_DN = 0.02
"""DN of 255: float32 harmonics against float64, and float64 against 400 by 40 points of a
footprint; measured 4e-4 and 4e-3."""

PROFILE_DRAWS_OTHER = 2e-3
"""Share of noisy pixels whose signal in float32 rounds to another grey level; measured 0."""

# ------------------------------------------------------------------------------------------ meshes

MESH_DN = 0.1
"""Rms between a sphere of 60 x 60 points as triangles and the sphere: what is asked of meshes."""

CEILING_MET_DN = 0.6
"""DN: by how much no pixel of 9,600 may come to the ceiling, for none has its place and phase;
measured 0.43
where cos^4 leaves one place the brightest, and 0.04 elsewhere."""

CEILING_ROUNDING_DN = 5e-3
"""DN: by how much the float32 mean of 20 images is above the ceiling, which is of float64; measured
0.002, and 0.0001 of closed forms."""

CEILING_NOISE = 0.05
"""Share: of 9,600 pixels the spread is known within 0.7 %; measured 0.02."""

TOLD_CEILING_DN = 0.3
"""DN: between the ceiling that some thousand pixels of noisy frames tell and that of their station;
measured 0.07."""

HEMISPHERE = 1e-3
"""Of a mean over 65,536 even rays of a hemisphere to an even light, relative."""

HEMISPHERE_OF_STRIPES = 0.012
"""And over 131,072 to stripes, whose edges count by chance, and with them the tunnel's ends."""

RIPPLE = 0.03
"""Of how much coarse stripes show in what a part scatters, relative: measured 0.02."""

SCATTERED_RMS_DN = 0.6
"""Of an image of a part that scatters, rms against 1,024 rays a pixel."""

SCATTERED_MOMENT_DN = 0.2
"""Of the mean of noise in closed form against the sum over images, where a part scatters."""

SCATTERED_CLOSED_DN = 0.01
"""Between the closed form and all images, where a part scatters."""

SPOT_LEVEL_DN = 0.4
"""Of the flawless level where a pixel looks at a spot: measured 0.25 against 1,024 rays."""

SPOT_RMS_DN = 1.6
"""Of the image of a dent through a spot, rms: measured 1.01 on 32 x 32 pixels."""

SPOT_MAX_DN = 9.0
"""The same, at most: measured 4.9."""

SPOT_NEARER_RMS_DN = 0.8
"""Rms of such an image a little off focus: measured 0.65; 1.6 where sub-rays were turned
by all that a place tells."""

SPOT_FLAT_DN = 0.6
"""Of sub-rays of a flat part a little off focus from one footprint: measured 0.31; 5 likewise."""

SPOT_PLANE_MM = 1e-3
"""Of light and footprint in float32 where a pixel looks at a spot: differences of large squares."""

SPOT_PLANE_DN = 0.05
"""Of an image in float32 where a pixel looks at a spot."""

SUB_RAY_VARIANCE = 0.06
"""Of what 8 x 8 sub-rays have of a spot's variance: the boxes about them are of one size."""

# ------------------------------------------------------------------------------------------- poses

POSED_LIGHT_MM = 5e-5
"""On a light 150 mm away, against the oracle in float64; measured 1.3e-5 on devices, and 1.5e-8 of
float64, which is the oracle's slopes by differences."""

POSED_DEFECT_MM = 1e-3
"""The same in dents and scratches, against float64; measured 1.4e-4."""

POSED_PLACE_MM = 6e-5
"""A point of a ray 400 mm long, in floats: two roundings of 400."""

POSED_RMS_DN = 0.25
"""Against 1,024 rays a pixel; measured 0.04 to 0.08 of a pinhole and 0.17 to 0.20 of a lens of 12
mm. Of the same part without a pose it is 0.06 and 0.20."""

RIDGE_MM = 0.5
"""On the light, where a ridge of 67 degrees is a spline of points 0.1 mm apart; measured 0.29."""

# ---------------------------------------------------------------------------------- laws of a spot

SPOT_LAW = 2e-5
"""Relative, of sums of squares in float32 whose terms are up to a hundred times what is left."""

SPOT_DISC = 1e-5
"""Relative, of the largest of 2,880 points of a circle against its furthest."""

# ------------------------------------------------------------------------------ slices of a pixel

SLICES_OF_SQUARES = 1.5
SLICES_RMS_DN = 0.03
"""Error of 20 slices over that of 8 x 8 squares, both against 48 x 48, and what is added where
both are small, in grey levels; the largest may be ten times as much."""

MAP_AS_DENT_DN = 0.3
"""DN: a dent as its formula and as a map of 8 points a sigma; measured 0.27, 20 where sub-rays of
a refined pixel saw the map averaged over the pixel."""
