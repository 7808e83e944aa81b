/* How many sub-rays pixels need on each side: `gpuspec/light/refinement.py` says why, and tells the same
   a second time. */
#include "portable.h"
#include "station.h"
#include "light_map.h"

/* Changes, in mm, below which few ask whether they are within the bound. */
#define QUIET 1e-3f

DEVICE int nearest_in(int place, int count) {
    return place < 0 ? 0 : place < count ? place : count - 1;
}

/* Entries of a plane from a place on; of places beyond its border, the nearest on it. */
DEVICE REAL entries(__global const float *plane, int row, int column, int rows, int columns,
                    int stride) {
    row = nearest_in(row, rows);
    __global const float *line = plane + (size_t)row * stride;
    if (column >= 0 && column + WIDTH <= columns) {
        return LOAD_ANYWHERE(line, column);
    }
    float found[WIDTH];
    for (int lane = 0; lane < WIDTH; lane++) {
        found[lane] = line[nearest_in(column + lane, columns)];
    }
    return LOAD_PRIVATE(found, 0);
}

/* A footprint's width, or where light is lost one that no neighbour has. */
DEVICE REAL width_of(REAL light, REAL wide) {
    REAL blind = BLIND_WIDTH;
    return light == 0.0f && wide == 1.0f ? blind : wide;
}

/* Pixels and those around them: light coordinates, and the widths of footprints. */
typedef struct {
    REAL above_left, above, above_right;
    REAL left, here, right;
    REAL below_left, below, below_right;
    REAL wide, wide_left, wide_right, wide_above, wide_below;
} Around;

/* |l_cc| + |l_rr| + 2 |l_cr| over a pixel, or more: a neighbour's width less one's own. Differences for
   which the border lacks a neighbour are 0: `across` and `down` say which it has on both sides. */
DEVICE REAL change_of(Around n, MASK across, bool down) {
    REAL none = 0.0f;
    REAL twice = 2.0f * n.here;
    REAL change = fabs(n.left - twice + n.right);
    change = (across ? change : none);
    if (down) {
        change += fabs(n.above - twice + n.below);
        REAL mixed = fabs((n.below_right - n.below_left) - (n.above_right - n.above_left));
        change += 0.5f * (across ? mixed : none);
    }
    change = max(change, max(fabs(n.wide - n.wide_left), fabs(n.wide - n.wide_right)));
    return max(change, max(fabs(n.wide - n.wide_above), fabs(n.wide - n.wide_below)));
}

/* The same of pixels of an image; of what is no pixel 0. */
DEVICE REAL changes(__global const float *light, __global const float *wide, int row, int column,
                    int rows, int columns, int stride) {
    REAL none = 0.0f;
    REAL place = (float)column + LANES;
    if (row < 0 || row >= rows) {
        return none;
    }
#define NEAR(plane, r, c) entries(plane, row + (r), column + (c), rows, columns, stride)
    Around n = {NEAR(light, -1, -1), NEAR(light, -1, 0), NEAR(light, -1, 1),
                NEAR(light, 0, -1), NEAR(light, 0, 0), NEAR(light, 0, 1),
                NEAR(light, 1, -1), NEAR(light, 1, 0), NEAR(light, 1, 1)};
    n.wide = width_of(n.here, NEAR(wide, 0, 0));
    n.wide_left = width_of(n.left, NEAR(wide, 0, -1));
    n.wide_right = width_of(n.right, NEAR(wide, 0, 1));
    n.wide_above = width_of(n.above, NEAR(wide, -1, 0));
    n.wide_below = width_of(n.below, NEAR(wide, 1, 0));
    MASK across = place > 0.0f && place < (float)(columns - 1);
    REAL change = change_of(n, across, row > 0 && row < rows - 1);
    return (place >= 0.0f && place < (float)columns ? change : none);
}

/* Sub-rays on each side: the least whose second differences are within the bound. */
DEVICE REAL sides_for(REAL change, REAL bound) {
    REAL most = 8.0f;
    REAL at_loss = AT_LOSS;
    REAL found = (change > 0.5f * BLIND_WIDTH ? at_loss : most);
    for (int n = 4; n >= 1; n /= 2) {
        REAL side = FLOAT(n);
        found = (change <= bound * FLOAT(n * n) ? side : found);
    }
    return found;
}

/* One work-item does a strip of pixels and some rows. */
__kernel void sides_needed(__global uchar *sides, __global const float *light,
                           __global const float *wide, int rows, int columns, int stride,
                           float bend, float width) {
    int left = (int)get_global_id(0) * STRIP_VECTORS * WIDTH;
    int top = (int)get_global_id(1) * STRIP_ROWS;
    int bottom = top + STRIP_ROWS < rows ? top + STRIP_ROWS : rows;
    REAL kept[3][STRIP_VECTORS + 2]; /* changes of three rows, with a vector more on each side */
    bool quiet[3];
    for (int row = top - 1; row <= bottom; row++) {
        int last = (row + 3) % 3;
        REAL most = 0.0f;
        for (int v = 0; v < STRIP_VECTORS + 2; v++) {
            kept[last][v] = changes(light, wide, row, left + (v - 1) * WIDTH, rows, columns, stride);
            most = max(most, kept[last][v]);
        }
        quiet[last] = !ANY(most > QUIET);
        if (row <= top) {
            continue;
        }
        bool still = quiet[0] && quiet[1] && quiet[2];
        for (int v = 0; v < STRIP_VECTORS && left + v * WIDTH < stride; v++) {
            size_t at = (size_t)(row - 1) * stride + left + v * WIDTH;
            REAL bound = bend * min(LOAD(wide, at), (REAL)width);
            REAL found = 1.0f;
            if (!still || ANY(bound < QUIET)) {
                REAL change = 0.0f;
                for (int i = 0; i < 3; i++) {
                    for (int shift = -1; shift <= 1; shift++) {
                        float *from = (float *)kept[i];
                        change = max(change, LOAD_PRIVATE(from, (v + 1) * WIDTH + shift));
                    }
                }
                found = sides_for(change, bound);
            }
            STORE_BYTE(found, sides, at);
        }
    }
}

/* Light coordinates and widths of pixels of a list, from their places in it, in the order of the image: those
   of a row are neighbours. */
__kernel void in_order(__global float *ordered, __global float *widths,
                       __global const float *light, __global const float *wide,
                       __global const uint *places) {
    size_t at = get_global_id(0) * WIDTH;
    COUNTER place = LOAD_COUNTERS(places, at);
    REAL own = GATHER(light, place);
    STORE(own, ordered, at);
    STORE(width_of(own, GATHER(wide, place)), widths, at);
}

/* Where the neighbours of some pixels stand among others: above, in the middle the pixels themselves, and
   below, on the border of the image the nearest; and whether there is one to the left, and to the right. */
typedef struct {
    COUNTER above;
    COUNTER middle;
    COUNTER below;
    COUNTER left;
    COUNTER right;
} Beside;

DEVICE Beside beside_of(__global const uint *planes, uint count, size_t at) {
    size_t plane = count;
    COUNTER bits = LOAD_COUNTERS(planes, 3 * plane + at);
    Beside found = {LOAD_COUNTERS(planes, at), LOAD_COUNTERS(planes, plane + at),
                    LOAD_COUNTERS(planes, 2 * plane + at), bits & 1u, bits >> 1};
    return found;
}

#define THREE(plane, line) \
    GATHER(plane, line - to.left), GATHER(plane, line), GATHER(plane, line + to.right)

/* Changes of `count` pixels. */
__kernel void changes_beside(__global float *change, __global const float *light,
                             __global const float *widths, __global const uint *beside,
                             uint count) {
    size_t at = get_global_id(0) * WIDTH;
    Beside to = beside_of(beside, count, at);
    MASK down = to.above != to.middle && to.below != to.middle;
    COUNTER above = down ? to.above : to.middle; /* differences of one line are 0 */
    COUNTER below = down ? to.below : to.middle;
    Around n = {THREE(light, above), THREE(light, to.middle), THREE(light, below),
                GATHER(widths, to.middle), GATHER(widths, to.middle - to.left),
                GATHER(widths, to.middle + to.right), GATHER(widths, to.above),
                GATHER(widths, to.below)};
    MASK across = TO_REAL(to.left * to.right) > 0.0f;
    STORE(change_of(n, across, true), change, at);
}

/* Sub-rays that `count` pixels need on each side, by the changes beside them and their own widths. */
__kernel void sides_beside(__global uchar *sides, __global const float *change,
                           __global const float *widths, __global const uint *beside, uint count,
                           __global const uint *own, float bend, float width) {
    size_t at = get_global_id(0) * WIDTH;
    Beside to = beside_of(beside, count, at);
    REAL lines[9] = {THREE(change, to.above), THREE(change, to.middle), THREE(change, to.below)};
    REAL most = 0.0f;
    for (int i = 0; i < 9; i++) {
        most = max(most, lines[i]);
    }
    REAL bound = bend * min(GATHER(widths, LOAD_COUNTERS(own, at)), (REAL)width);
    STORE_BYTE(sides_for(most, bound), sides, at);
}

/* Puts out the light of chosen pixels. */
__kernel void put_out(__global float *irradiance, __global const uint *chosen) {
    irradiance[chosen[get_global_id(0)]] = 0.0f;
}
