/* An entry of the light map, and in OpenCL where it lies: four planes of floats, one sub-ray's after
   another's. */
#ifndef LIGHT_MAP_H
#define LIGHT_MAP_H

/* What a sub-ray knows of the light, lengths in mm. */
STRUCT(Ray) {
    REAL light;      /* coordinate l */
    REAL wide;       /* widths of the two boxes over which it averages */
    REAL narrow;
    REAL irradiance; /* relative; 0 where lost */
};

#ifndef GPUSPEC_GLSL

#define LIGHT_MAP(access)                                                                     \
    __global access float *light, __global access float *wide, __global access float *narrow, \
        __global access float *irradiance

DEVICE Ray ray_of(LIGHT_MAP(const), size_t at) {
    Ray ray = {LOAD(light, at), LOAD(wide, at), LOAD(narrow, at), LOAD(irradiance, at)};
    return ray;
}

#define RAY_AT(at) ray_of(light, wide, narrow, irradiance, at)

#endif

#endif
