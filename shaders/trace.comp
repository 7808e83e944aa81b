/* The light map: one invocation per pixel of a tile. A GPU skips what a part has not, lavapipe
   works it out and masks it: so GROOVES, MAPS and NEWTON_STEPS 0 tell the compiler. */
#include "portable.h"
#include "station.h"
#include "surface.h"
#include "reflection.h"

layout(local_size_x = 128) in;

layout(std140, set = 0, binding = 0) uniform Geometries { Geometry geometry; };
layout(std140, set = 0, binding = 1) uniform Call {
    ivec4 size; /* columns, rows of the tile, its first row, sub-rays */
    ivec4 more; /* number of the image, number of measured maps, 0, 0 */
};
layout(std430, set = 0, binding = 2) readonly buffer Grooves { Groove grooves[]; };
layout(std430, set = 0, binding = 3) readonly buffer Firsts { int firsts[]; };
layout(std430, set = 0, binding = 4) readonly buffer Pieces { int pieces[]; };
layout(std430, set = 0, binding = 5) readonly buffer Maps { Map maps[]; };
layout(std430, set = 0, binding = 6) readonly buffer Coefficients { float coefficients[]; };
layout(std430, set = 0, binding = 7) buffer Light { float light[]; };
layout(std430, set = 0, binding = 8) buffer Footprint { float footprint[]; };
layout(std430, set = 0, binding = 9) buffer Irradiance { float irradiance[]; };
#ifdef ACROSS
layout(std430, set = 0, binding = 10) buffer Across { float across[]; };
#else
layout(std430, set = 0, binding = 10) buffer Lost { uint lost[]; };
#endif

#define GROOVE(i) grooves[i]
#ifdef GROOVES
#define BLOCK_FIRST(b) firsts[b]
#else
#define BLOCK_FIRST(b) 0
#endif
#define PIECE(i) pieces[i]
#define MAP(i) maps[i]
#define COEFFICIENT(i) coefficients[i]

Geometry g;
#ifdef MAPS
int map_count;
#else
const int map_count = 0;
#endif

#include "relief.glsl"

void main() {
    int column = int(gl_GlobalInvocationID.x);
    int row = int(gl_GlobalInvocationID.y);
    if (column >= size.x) {
        return;
    }
    g = geometry;
#ifdef MAPS
    map_count = more.y;
#endif
    int at = row * size.x + column;
    int plane = size.x * size.y;
    float reason = LOST_BESIDE;
    bool seen = false;
    for (int i = 0; i < size.w; i++) {
        Sight v = sub_ray(column, size.z + row, i);
        light[at + i * plane] = v.light;
        footprint[at + i * plane] = v.footprint;
        irradiance[at + i * plane] = v.irradiance;
#ifdef ACROSS
        across[at + i * plane] = v.across;
#endif
        reason = max(reason, v.lost);
        seen = seen || v.lost == LOST_NOT;
    }
#ifndef ACROSS
    lost[at] = seen ? 0u : uint(reason);
#endif
}
