/* The station as the device sees it. Every member is a float and every struct a whole number of
   four, so that numpy, OpenCL and GLSL's blocks lay out the same bytes; `gpuspec/parameters.py`
   reads the names here and fills them. Lengths in mm. */
#ifndef STATION_H
#define STATION_H

/* What a light map depends on, but for the relief. */
RECORD(Geometry) {
    float camera_height;       /* h, of the pupil above z = 0 */
    float pupil;               /* diameter D, 0 for a pinhole */
    float sampling;            /* p, from pixel to pixel on z = 0 */
    float subsampling;         /* sub-rays on each side of a pixel, n */
    float columns;             /* of the image, N */
    float rows;                /* M */
    float rises;               /* 1: rays meet the surface's height; 0: z = 0, its slopes count */
    float vignetting;          /* 1: cos^4 over the field, 0: none */
    float half_length;         /* of the part, along x */
    float half_width;          /* along y */
    float curvature_x;         /* of the crown: 1/radius, 0 flat */
    float curvature_y;
    float section;             /* of the tunnel: SECTION_... */
    float tunnel_top;          /* height H, or radius of the arch */
    float tunnel_half_width;
    float tunnel_half_length;
    float opening_half_length; /* the camera's opening in the tunnel */
    float opening_half_width;
    float roughness;           /* rms slope alpha */
    float refractive_index;    /* n */
    float extinction;          /* k; n = k = 0: an ideal mirror */
    float unused_0;
    float unused_1;
    float unused_2;
};

/* What never retraces a light map. */
RECORD(Design) {
    float luminous_share;      /* of the stripes, a / P */
    float periods_per_mm;      /* 1 / P */
    float dark_leak;           /* beta */
    float images;              /* K */
    float step;                /* from image to image, in periods */
    float distinct_shifts;     /* that fill the period in equal steps; 0: they do not */
    float lag;                 /* of the differential, in images */
    float pairs;               /* of the differential */
    float exposure;            /* gain g */
    float full_scale;          /* DN */
    float saturation;          /* capacity, e */
    float read_noise;          /* e */
    float dark_signal;         /* e */
    float dsnu;                /* e */
    float prnu;
    float black_level;         /* DN */
    float noise;               /* 1 with noise, 0 without */
    float seed_low;            /* low and high 16 bits: a float does not count to 2^32 */
    float seed_high;
    float unused;
};

/* A straight piece of a groove's centre line; a dent or a bump is a piece of no length. */
RECORD(Groove) {
    float column;              /* of its start, whole pixels: with the fraction exact anywhere */
    float row;
    float column_fraction;
    float row_fraction;
    float along_x;             /* to its other end */
    float along_y;
    float inverse_square;      /* 1 / length^2, 0 where there is none */
    float inverse_length;
    float height;              /* at the centre line, < 0 down */
    float inverse_variance;    /* 1 / sigma^2 */
    float defect;              /* its number */
    float unused;
};

/* A map of measured relief: B-spline coefficients on a regular grid. */
RECORD(Map) {
    float column;              /* of its corner of least x and least y, whole pixels */
    float row;
    float column_fraction;
    float row_fraction;
    float points_x;            /* of the grid */
    float points_y;
    float first_low;           /* its first coefficient: low and high 16 bits */
    float first_high;
    float points_per_mm_x;     /* 1 / pitch */
    float points_per_mm_y;
    float unused_0;
    float unused_1;
};

#endif
