/* The aspect image in closed form: the same cost for 8 images as for 800. */
#include "portable.h"
#include "station.h"
#include "stripes.h"
#include "sensor.h"
#include "image.h"
#include "tile.glsl"

void main() {
    if (gl_GlobalInvocationID.x >= uint(size.x)) {
        return;
    }
    place_pixel();
    Ray ray = ray_at(0);
    Trapezoid t = exposed_ray(d, ray.light, ray.footprint, ray.irradiance, 1);
    grey[at] = d.full_scale * mean_over_scan(t, d.distinct_shifts);
}
