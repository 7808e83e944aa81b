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
    vec3 ray = RAY(0);
    grey[at] = d.full_scale * mean_over_scan(exposed_ray(d, ray.x, ray.y, ray.z, 1), d.distinct_shifts);
}
