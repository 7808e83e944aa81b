/* One fragment per pixel: IMAGE number k, the MEAN of all images, FUSE, a target for each fusion,
   or FAULTY, the share of a pattern's samples that are none. */
#include "portable.h"
#include "station.h"
#include "stripes.h"
#include "sensor.h"
#include "image.h"
#include "rays.glsl"
#include "scan.glsl"

#ifdef FUSE
layout(location = 0) out float mean;
layout(location = 1) out float high;
layout(location = 2) out float low;
layout(location = 3) out float deviation;
layout(location = 4) out float difference;
#else
out float grey;
#endif
#ifdef IMAGE
uniform int k;
#endif

void main() {
    d = design();
    uvec2 pixel = uvec2(pixel_of(texel(), textureSize(rays, 0).x));
#ifdef PATTERN
    g = geometry;
    place = vec2(pixel);
#endif
#if defined(FUSE)
    Fusion f = fusion_over_images(d, Pixels(sub_rays), pixel.x, pixel.y);
    mean = f.mean;
    high = f.high;
    low = f.low;
    deviation = f.deviation;
    difference = f.difference;
#elif defined(MEAN)
    grey = mean_of(pixel.x, pixel.y);
#elif defined(FAULTY)
    grey = faulty_share();
#else
    grey = image_of(pixel.x, pixel.y, k);
#endif
}
