/* Records of `kernels/station.h` from lists of vec4: three loads of four floats, which drivers do
   not make of twelve of one. The including shader says how one is fetched: GROOVE_PART(i), MAP_PART(i). */
Groove groove_record(int i) {
    vec4 a = GROOVE_PART(3 * i);
    vec4 b = GROOVE_PART(3 * i + 1);
    vec4 c = GROOVE_PART(3 * i + 2);
    return Groove(a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w, c.x, c.y, c.z, c.w);
}

Map map_record(int i) {
    vec4 a = MAP_PART(3 * i);
    vec4 b = MAP_PART(3 * i + 1);
    vec4 c = MAP_PART(3 * i + 2);
    return Map(a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w, c.x, c.y, c.z, c.w);
}

/* What `kernels/relief.h` asks for. */
struct Lists {
    int maps;
};

#define GROOVE(lists, i) groove_record(i)
#define MAP(lists, i) map_record(i)
