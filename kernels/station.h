/* The station as the device sees it: structs of float4 only, so that numpy, OpenCL and std140
   lay out the same bytes. `gpuspec/parameters.py` fills them; lengths in mm. */
#ifndef STATION_H
#define STATION_H

STRUCT(Geometry) {
    float4 camera;   /* height h, pupil diameter D, sampling p, sub-rays per side n */
    float4 image;    /* columns N, rows M, 1 height surface or 0 orientation only, 1 cos^4 */
    float4 part;     /* half length, half width, curvature along x, along y (1/radius, 0 flat) */
    float4 tunnel;   /* section 0 ceiling 1 box 2 arch, height or radius, half width, half length */
    float4 opening;  /* half length, half width, 0, rms roughness slope alpha */
    float4 material; /* refractive index n, extinction k (both 0: reflectance 1), 0, 0 */
};

STRUCT(Design) {
    float4 stripes;  /* luminous width a / P, 1 / period P (1/mm), leak beta, 0 */
    float4 sequence; /* images K, step / period, distinct shifts that fill the period, lag */
    float4 sensor;   /* exposure g, full scale (DN), saturation (e), read noise (e) */
    float4 dark;     /* dark signal (e), DSNU (e), PRNU, black level (DN) */
    float4 noise;    /* 1 with noise, seed's low and high 16 bits, pairs of the differential */
};

/* A straight piece of a groove's centre line; a dent or a bump is a piece of no length. */
STRUCT(Groove) {
    float4 start;    /* column, row (whole pixels), their fractions: exact far from the origin */
    float4 course;   /* dx, dy to the other end (mm), 1/length^2 (0: none), 1/length */
    float4 profile;  /* height at the centre line (mm, < 0 down), 1/sigma^2, number of the defect, 0 */
};

/* A map of measured relief: B-spline coefficients on a regular grid. */
STRUCT(Map) {
    float4 start;    /* column, row (whole pixels) of its corner of least x and least y, fractions */
    float4 grid;     /* points along x, along y, first coefficient (two 16-bit halves) */
    float4 pitch;    /* 1/pitch along x, along y (1/mm), 0, 0 */
};

#endif
