/* A pixel that one straight groove crosses, in slices along it: across them alone its light coordinate
   bends, so that they tell in 20 rays what squares tell in 64. */
#ifndef SLICES_H
#define SLICES_H

/* What of a pixel a sub-ray stands for, in pixels, y up. */
STRUCT(Slice) {
    REAL x;        /* its middle, from the pixel's */
    REAL y;
    REAL across_x; /* sides of a parallelogram of its variance: from slice to slice, */
    REAL across_y;
    REAL along_x;  /* and along the groove */
    REAL along_y;
    REAL share;    /* of the pixel, 1 on average */
};

/* Where a line along the groove cuts the pixel: its middle, and its length. */
STRUCT(Chord) {
    REAL x;
    REAL y;
    REAL length;
};

/* The chord at `depth` pixels behind the corner of a pixel that lies the furthest along (nx, ny), a unit
   vector across the groove: of a triangle at the corner, or between two sides of the pixel. */
DEVICE Chord chord_at(REAL nx, REAL ny, REAL depth, MASK corner) {
    REAL ax = fabs(nx);
    REAL ay = fabs(ny);
    REAL wide = max(ax, ay);
    REAL place = (0.5f * (ax + ay) - depth) / wide;
    REAL x = 0.5f - 0.5f * depth / max(ax, 1e-6f);
    REAL y = 0.5f - 0.5f * depth / max(ay, 1e-6f);
    x = corner ? x : (ax >= ay ? place : 0.0f * place);
    y = corner ? y : (ax >= ay ? 0.0f * place : place);
    Chord c;
    c.x = nx < 0.0f ? -x : x;
    c.y = ny < 0.0f ? -y : y;
    c.length = (corner ? depth / max(ax * ay, 1e-6f) : 1.0f / wide);
    return c;
}

/* Slice `index` of `count`, an even number, of a pixel that a groove across (nx, ny) crosses. Its ends are where
   chords begin to grow or to shrink: so two of them, those of Gauss and Legendre, tell its share, its
   middle and its variance exactly. */
DEVICE Slice slice_of(REAL nx, REAL ny, int index, int count) {
    int half_count = count / 2;
    float from = FLOAT(index < half_count ? index : count - 1 - index);
    float side = index < half_count ? -1.0f : 1.0f;
    REAL ax = fabs(nx);
    REAL ay = fabs(ny);
    REAL thin = min(ax, ay);
    REAL wide = max(ax, ay);
    /* Of half of them, those in a corner: by what it takes of the way; none or all where nothing is
       left of the one or of the other. */
    REAL few = rint(FLOAT(count) * thin / (thin + wide));
    REAL none = 0.0f;
    REAL least = (thin > 1e-6f ? none + 1.0f : none);
    REAL most = FLOAT(half_count) - (wide - thin > 1e-6f ? none + 1.0f : none);
    few = clamp(few, least, most);
    MASK corner = from < few;
    REAL each = (corner ? thin / max(few, 1.0f)
                        : 0.5f * (wide - thin) / max(FLOAT(half_count) - few, 1.0f));
    REAL middle = (corner ? each * (from + 0.5f) : thin + each * (from - few + 0.5f));
    REAL off = 0.28867513f * each; /* 1/2 sqrt(1/3) */
    Chord a = chord_at(side * nx, side * ny, middle - off, corner);
    Chord b = chord_at(side * nx, side * ny, middle + off, corner);
    REAL sum = max(a.length + b.length, 1e-6f);
    REAL first = a.length / sum;
    REAL second = 1.0f - first;
    REAL apart = sqrt(12.0f * first * second);
    REAL cubes = a.length * a.length * a.length + b.length * b.length * b.length;
    REAL length = sqrt(cubes / sum);
    Slice s;
    s.x = first * a.x + second * b.x;
    s.y = first * a.y + second * b.y;
    s.across_x = apart * (b.x - a.x);
    s.across_y = apart * (b.y - a.y);
    s.along_x = -length * ny;
    s.along_y = length * nx;
    s.share = FLOAT(count) * 0.5f * each * (a.length + b.length);
    return s;
}

#endif
