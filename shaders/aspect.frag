/* One fragment per pixel: the aspect image in closed form, at the same cost for 8 images as for
   800; or with LOST, why the pixel sees no light. */
#include "portable.h"
#include "station.h"
#include "stripes.h"
#include "sensor.h"
#include "image.h"
#include "rays.glsl"

out float value;

void main() {
#ifdef LOST
    float first = entry(0).w;
    float least = first;
    float most = first;
    for (int i = 1; i < sub_rays; i++) {
        float lost = entry(i).w;
        least = min(least, lost);
        most = max(most, lost);
    }
    /* Seen if any sub-ray is, else the largest reason, as in `kernels/trace.cl`; target of bytes. */
    value = (least == 0.0 ? 0.0 : most) / 255.0;
#else
    vec3 ray = RAY(0);
    Trapezoid t = exposed_ray(given, ray.x, ray.y, ray.z, 1);
    value = given.full_scale * mean_over_scan(t, given.distinct_shifts);
#endif
}
