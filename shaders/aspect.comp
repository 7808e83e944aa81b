/* The aspect image in closed form: the same cost for 8 images as for 800; or with LOST, why pixels see
   no light. */
#include "portable.h"
#include "station.h"
#include "surface.h"
#include "reflection.h"
#include "stripes.h"
#include "sensor.h"
#include "image.h"
#include "tile.glsl"

void main() {
    if (gl_GlobalInvocationID.x >= uint(size.x)) {
        return;
    }
    place_pixel();
#ifdef LOST
    float reason = LOST_BESIDE;
    for (int i = 0; i < sub_rays; i++) {
        reason = loss_of_both(reason, lost_at(i));
    }
    grey[at] = reason;
#else
    Trapezoid t = exposed_ray(d, ray_at(0), 1);
    grey[at] = d.full_scale * mean_over_scan(t, d.distinct_shifts);
#endif
}
