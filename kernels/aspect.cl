/* The aspect image in closed form: the same cost for 8 images as for 800. Grey levels begin with the
   first row of the launch. */
#include "portable.h"
#include "station.h"
#include "stripes.h"
#include "sensor.h"
#include "image.h"

__kernel void aspect(__global float *mean, LIGHT_MAP(const), __global const Design *restrict design, int sub_rays, int first_row) {
    Design d = *design;
    size_t at = (get_global_id(1) * get_global_size(0) + get_global_id(0)) * WIDTH;
    Trapezoid t = exposed_ray(d, RAY_AT(at), 1);
    size_t begin = get_global_offset(1) * get_global_size(0) * WIDTH;
    STORE(d.full_scale * mean_over_scan(t, d.distinct_shifts), mean, at - begin);
}
