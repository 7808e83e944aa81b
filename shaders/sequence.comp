/* One image (IMAGE), the mean of all (MEAN) or every fusion (FUSE), image by image; or FAULTY, the
   share of a pattern's samples that are none. */
#include "portable.h"
#include "station.h"
#include "stripes.h"
#include "sensor.h"
#include "image.h"
#include "tile.glsl"
#include "scan.glsl"

void main() {
    if (gl_GlobalInvocationID.x >= uint(size.x)) {
        return;
    }
    place_pixel();
    uint column = pixel().x;
    uint row = pixel().y;
#ifdef PATTERN
    place = vec2(float(column), float(row));
#endif
#ifdef IMAGE
    grey[at] = image_of(column, row, more.x);
#endif
#ifdef FAULTY
    grey[at] = faulty_share();
#endif
#ifdef MEAN
    grey[at] = mean_of(column, row);
#endif
#ifdef FUSE
    Fusion f = fusion_over_images(d, Pixels(sub_rays), column, row);
    grey[at] = f.mean;
    grey[at + plane] = f.high;
    grey[at + 2 * plane] = f.low;
    grey[at + 3 * plane] = f.deviation;
    grey[at + 4 * plane] = f.difference;
#endif
}
