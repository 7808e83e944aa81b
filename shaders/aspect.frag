/* One fragment per pixel: the aspect image in closed form, at the same cost for 8 images as for
   800; or with LOST, why the pixel sees no light. */
#include "portable.h"
#include "station.h"
#include "surface.h"
#include "reflection.h"
#include "stripes.h"
#include "sensor.h"
#include "image.h"
#include "rays.glsl"

out float value;

void main() {
#ifdef LOST
    float reason = LOST_BESIDE;
    for (int i = 0; i < sub_rays; i++) {
        reason = loss_of_both(reason, lost_at(i));
    }
    value = reason;
#else
    Trapezoid t = exposed_ray(given, ray_at(0), 1);
    value = given.full_scale * mean_over_scan(t, given.distinct_shifts);
#endif
}
