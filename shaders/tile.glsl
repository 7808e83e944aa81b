/* What a compute shader needs to make images of a tile: its light map in storage buffers. One
   invocation per pixel; `place_pixel` fills what scan.glsl asks for. Without NOISE or with ONE_RAY
   the compiler is told, or lavapipe works out every image's noise only to mask it. */
layout(local_size_x = GROUP) in;

layout(std140, set = 0, binding = 0) uniform Designs {
    Design design;
#ifdef PATTERN
    Geometry geometry; /* for the user's pattern, as `g` */
#endif
};
layout(std140, set = 0, binding = 1) uniform Call {
    ivec4 size; /* columns, rows of the tile, its first row, sub-rays */
    ivec4 more; /* number of the image, 0, 0, 0 */
};
layout(std430, set = 0, binding = 2) readonly buffer Light { float light[]; };
layout(std430, set = 0, binding = 3) readonly buffer Footprint { float footprint[]; };
layout(std430, set = 0, binding = 4) readonly buffer Irradiance { float irradiance[]; };
layout(std430, set = 0, binding = 5) buffer Grey { float grey[]; };
#ifdef PATTERN
layout(std430, set = 0, binding = 6) readonly buffer Across { float across[]; };

Geometry g;
#endif

Design d;
#ifdef ONE_RAY
const int sub_rays = 1;
#else
int sub_rays;
#endif
int at;
int plane;

Ray ray_at(int i) {
    int entry = at + i * plane;
    return Ray(light[entry], footprint[entry], irradiance[entry]);
}
#define ACROSS(i) across[at + (i) * plane]

void place_pixel() {
    d = design;
#ifdef PATTERN
    g = geometry;
#endif
#ifndef NOISE
    d.noise = 0.0;
#endif
#ifndef ONE_RAY
    sub_rays = size.w;
#endif
    plane = size.x * size.y;
    at = int(gl_GlobalInvocationID.y) * size.x + int(gl_GlobalInvocationID.x);
}
