/* One fragment per sub-ray: the light map of a tile. A GPU skips what a part has not, llvmpipe
   works it out and masks it: so GROOVES, MAPS and NEWTON_STEPS 0 tell the compiler. */
#include "portable.h"
#include "station.h"
#include "surface.h"
#include "reflection.h"
#include "texels.glsl"

layout(std140) uniform Block {
    Geometry g;
};
#ifdef MAPS
uniform int map_count;
#endif
uniform int width; /* of the tile's texture */

/* Lists lie in textures row by row, LIST_WIDTH (a power of two) entries each. */
uniform sampler2D grooves;
uniform isampler2D block_first;
uniform isampler2D pieces;
uniform sampler2D maps;
uniform sampler2D coefficients;
#define ENTRY(list, i) texelFetch(list, ivec2((i) % LIST_WIDTH, (i) / LIST_WIDTH), 0)

#define GROOVE_PART(i) ENTRY(grooves, i)
#define MAP_PART(i) ENTRY(maps, i)
#define PIECE(lists, i) ENTRY(pieces, i).x
#define COEFFICIENT(lists, at) ENTRY(coefficients, int(at)).x
#include "records.glsl"
#include "relief.h"
#include "sight.glsl"

out vec4 entry;

void main() {
    ivec2 at = texel();
    ivec2 pixel = pixel_of(at, width);
    Lists lists = Lists(0);
#ifdef MAPS
    lists.maps = map_count;
#endif
    int first = 0;
    int last = 0;
#ifdef GROOVES
    int block = block_of(pixel.x, pixel.y, int(g.columns));
    first = ENTRY(block_first, block).x;
    last = ENTRY(block_first, block + 1).x;
#endif
    int index = at.y / (rows * WRAPS);
    Sight v = sub_ray(g, lists, first, last, float(pixel.x), float(pixel.y), index);
    entry = entry_of(v);
}
