/* The light map: one invocation per pixel of a tile. A GPU skips what a part has not, lavapipe
   works it out and masks it: so GROOVES, MAPS and NEWTON_STEPS 0 tell the compiler. */
#include "portable.h"
#include "station.h"
#include "surface.h"
#include "reflection.h"

layout(local_size_x = GROUP) in;

layout(std140, set = 0, binding = 0) uniform Geometries { Geometry geometry; };
layout(std140, set = 0, binding = 1) uniform Call {
    ivec4 size; /* columns, rows of the tile, its first row, sub-rays */
    ivec4 more; /* number of the image, number of measured maps, columns of the image, 0 */
};
layout(std430, set = 0, binding = 2) readonly buffer Grooves { vec4 grooves[]; };
layout(std430, set = 0, binding = 3) readonly buffer Firsts { int firsts[]; };
layout(std430, set = 0, binding = 4) readonly buffer Pieces { int pieces[]; };
layout(std430, set = 0, binding = 5) readonly buffer Maps { vec4 maps[]; };
layout(std430, set = 0, binding = 6) readonly buffer Coefficients { float coefficients[]; };
layout(std430, set = 0, binding = 7) buffer Rays { vec4 rays[]; };
#ifdef LISTED
layout(std430, set = 0, binding = 8) readonly buffer Pixels_ { uint pixels[]; };
#endif

#define GROOVE_PART(i) grooves[i]
#define MAP_PART(i) maps[i]
#define PIECE(lists, i) pieces[i]
#define COEFFICIENT(lists, at) coefficients[at]
#include "records.glsl"
#include "relief.h"
#include "sight.glsl"

void main() {
    int column = int(gl_GlobalInvocationID.x);
    int row = int(gl_GlobalInvocationID.y);
    if (column >= size.x) {
        return;
    }
    Geometry g = geometry;
    Lists lists = Lists(0);
#ifdef MAPS
    lists.maps = more.y;
#endif
    int at = row * size.x + column;
    row += size.z;
#ifdef LISTED
    uint number = pixels[row * size.x + column];
    column = int(number % uint(more.z));
    row = int(number / uint(more.z));
#endif
    int first = 0;
    int last = 0;
#ifdef GROOVES
    int block = block_of(column, row, int(g.columns));
    first = firsts[block];
    last = firsts[block + 1];
#endif
    int plane = size.x * size.y;
    for (int i = 0; i < size.w; i++) {
        Sight v = sub_ray(g, lists, first, last, float(column), float(row), i);
        rays[at + i * plane] = entry_of(v);
    }
}
