/* The station as the device sees it. Every member is a float and every struct a whole number of
   four, so that numpy, OpenCL and GLSL's blocks lay out the same bytes; `gpuspec/light/records.py`
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
    float spherical;           /* 1: the crown is a sphere, of curvature_x */
    float focus;               /* F, from the pupil to the plane in focus; 0: on the part everywhere */
    float blur;                /* standard deviation of the lens's spot on z = 0 */
    float spot;                /* side of a square of the variance of where a pixel looks */
    float widening;            /* by which sub-rays are further than the pixel's from its centre, as a */
    float warp;                /* share of their distance t in pixels, and of its cube */
    float lean;                /* mm of the pupil, on average, for each mm from the pixel's centre */
    float least_lean;          /* share of it that counts where the part is nearly flat */
    float view_xx;             /* of a posed camera: its axes in the part's frame, xx and yy less 1, */
    float view_xy;             /* x of its y axis, */
    float view_xz;             /* of that which looks back at it; */
    float view_yx;
    float view_yy;
    float view_yz;
    float view_zx;
    float view_zy;
    float view_zz;
    float view_x;              /* and the middle of its image */
    float view_y;
    float view_z;
    float pose_xx;             /* of a posed part: its axes in the tunnel's frame, */
    float pose_xy;
    float pose_xz;
    float pose_yx;
    float pose_yy;
    float pose_yz;
    float pose_zx;
    float pose_zy;
    float pose_zz;
    float pose_x;              /* and its origin */
    float pose_y;
    float pose_z;
    float march_steps;         /* of a ray that may meet the part again; 0: none may */
    float march_slack;         /* how far below the surface it has met it */
    float highest;             /* point of the part */
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
    float harmonics;           /* of a light that is no stripes: how many, 0 of stripes */
    float mean_luminance;      /* of it over a period, and of each harmonic the cosine and the sine */
    float cosine_1;
    float sine_1;
    float cosine_2;
    float sine_2;
    float cosine_3;
    float sine_3;
    float cosine_4;
    float sine_4;
    float cosine_5;
    float sine_5;
    float cosine_6;
    float sine_6;
    float cosine_7;
    float sine_7;
    float cosine_8;
    float sine_8;
    float cosine_9;
    float sine_9;
    float cosine_10;
    float sine_10;
    float cosine_11;
    float sine_11;
    float cosine_12;
    float sine_12;
    float cosine_13;
    float sine_13;
    float cosine_14;
    float sine_14;
    float cosine_15;
    float sine_15;
    float cosine_16;
    float sine_16;
    float diffuse;             /* what the part scatters of all the light, over what it mirrors of 1 */
    float unused_0;
    float unused_1;
};

/* A straight piece of a groove's centre line; a dent or a bump is a piece of no length. Or an edge
   defect, half an ellipse about its place on the part's edge, which a block lists after the grooves:
   along the edge to the ellipse's end, height 0, and 1 / depth^2 in the variance's place. */
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
    float outline;             /* of an edge defect: -1 chip, 1 burr; 0 of a groove */
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
