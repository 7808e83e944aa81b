/* The light map of a posed part or camera, or of a part that a ray may meet twice. */
#define POSED
#include "trace.cl"
