/* A C face of Embree 3 and 4 for batches of rays: nothing in it depends on which of the two is installed. */
#ifndef LUXEL_EMBREE_SHIM_H
#define LUXEL_EMBREE_SHIM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* A device and one committed scene of triangles. Immutable once built: any number of threads may query it. */
typedef struct LuxelEmbree LuxelEmbree;

/* Rays as a structure of arrays, each of `count` floats; no alignment is asked for. */
typedef struct LuxelRays {
    const float *origin_x, *origin_y, *origin_z;
    const float *direction_x, *direction_y, *direction_z;
    const float *t_min, *t_max;
    size_t count;
    bool coherent;
} LuxelRays;

/* face = triangle * 2 + (1 if the back was met); UINT32_MAX and t = infinity if nothing was. */
typedef struct LuxelHit {
    float t, u, v;
    uint32_t face;
} LuxelHit;

typedef struct LuxelEmbreeInfo {
    uint32_t major, minor, patch;
    /* The widest packet that the library traces as one packet on this processor: 1, 4, 8 or 16. */
    uint32_t native_width;
} LuxelEmbreeInfo;

/* What C says about the structs above, to be compared with what the bindings say. */
typedef struct LuxelEmbreeLayout {
    size_t rays_size, rays_count_offset, rays_coherent_offset;
    size_t hit_size, hit_face_offset;
    size_t info_size;
} LuxelEmbreeLayout;

/* Copies the triangles and builds. Positions are xyz triples, all finite; indices are in range.
   Returns 0 and sets *out, or an error code and leaves *out alone. Needs `triangle_count` < 2^31. */
int32_t luxel_embree_new(const float *positions, size_t vertex_count, const uint32_t *triangles,
                         size_t triangle_count, LuxelEmbree **out);
void luxel_embree_free(LuxelEmbree *tracer);

/* A text for an error code of luxel_embree_new; static storage. */
const char *luxel_embree_error_text(int32_t code);

void luxel_embree_info(const LuxelEmbree *tracer, LuxelEmbreeInfo *out);

/* Traces `rays->count` rays in packets of `width` (1, 4, 8 or 16; anything else is taken as 1) and writes that
   many results. A ray that is not finite, has no direction, or has not t_min < t_max meets nothing.
   Denormals count as zero inside; the caller's floating-point mode is restored. */
void luxel_embree_closest_hits(const LuxelEmbree *tracer, const LuxelRays *rays, uint32_t width, LuxelHit *hits);

/* As above; writes 1 where anything lies on the ray, else 0. */
void luxel_embree_occluded(const LuxelEmbree *tracer, const LuxelRays *rays, uint32_t width, uint8_t *occluded);

/* What rtcIntersect costs by itself, for benches: the same packets and flag, unit directions and unlimited distances,
   no ray looked at, nothing written. Returns the triangle ids of all hits, added up. */
uint32_t luxel_embree_bare(const LuxelEmbree *tracer, const LuxelRays *rays, uint32_t width);

void luxel_embree_layout(LuxelEmbreeLayout *out);

/* Self-test: traces one packet with guard bytes before and behind its ray and hit structs;
   false if the library wrote outside of them. */
bool luxel_embree_guards_survive(const LuxelEmbree *tracer, uint32_t width);

/* Whether denormals are flushed on the calling thread right now; lets a test see that the mode is restored. */
bool luxel_embree_flushes_denormals(void);

#endif
