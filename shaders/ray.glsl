/* A sub-ray's entry of the light map as four floats: light, wide, narrow, irradiance, and minus the
   reason where it is lost. For a light of the user's own one width, and the light point's other
   coordinate in the place of the narrow one. The including shader fetches it by entry(i). */
Ray ray_at(int i) {
    vec4 ray = entry(i);
#ifdef PATTERN
    ray.z = 0.0;
#endif
    return Ray(ray.x, ray.y, ray.z, max(ray.w, 0.0));
}

#define ACROSS(i) entry(i).z

float lost_at(int i) {
    return max(-entry(i).w, 0.0);
}
