#include "embree_shim.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#ifndef LUXEL_EMBREE_VERSION
#error "build.rs says which Embree it found"
#endif
#if LUXEL_EMBREE_VERSION >= 4
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

struct LuxelEmbree {
    RTCDevice device;
    RTCScene scene;
    /* Powers of two, exact: vertices and origins times `scale` lie near 1, so that products of coordinates
       neither overflow nor vanish, whatever the unit of the scene. */
    float scale, unscale;
};

/* ---- the two versions differ in how flags are handed over, and in nothing else that is used here ---- */

#if RTC_VERSION_MAJOR >= 4
typedef struct RTCIntersectArguments ClosestFlags;
typedef struct RTCOccludedArguments OccludedFlags;

static ClosestFlags closest_flags(bool coherent) {
    ClosestFlags flags;
    rtcInitIntersectArguments(&flags);
    flags.flags = coherent ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
    return flags;
}

static OccludedFlags occluded_flags(bool coherent) {
    OccludedFlags flags;
    rtcInitOccludedArguments(&flags);
    flags.flags = coherent ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
    return flags;
}

#define INTERSECT1(scene, flags, rayhit) rtcIntersect1(scene, rayhit, flags)
#define OCCLUDED1(scene, flags, ray) rtcOccluded1(scene, ray, flags)
#define INTERSECT(width, valid, scene, flags, rayhit) JOIN(rtcIntersect, width)(valid, scene, rayhit, flags)
#define OCCLUDED(width, valid, scene, flags, ray) JOIN(rtcOccluded, width)(valid, scene, ray, flags)
#else
typedef struct RTCIntersectContext ClosestFlags;
typedef struct RTCIntersectContext OccludedFlags;

static ClosestFlags closest_flags(bool coherent) {
    ClosestFlags flags;
    rtcInitIntersectContext(&flags);
    flags.flags = coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
    return flags;
}

static OccludedFlags occluded_flags(bool coherent) {
    return closest_flags(coherent);
}

#define INTERSECT1(scene, flags, rayhit) rtcIntersect1(scene, flags, rayhit)
#define OCCLUDED1(scene, flags, ray) rtcOccluded1(scene, flags, ray)
#define INTERSECT(width, valid, scene, flags, rayhit) JOIN(rtcIntersect, width)(valid, scene, flags, rayhit)
#define OCCLUDED(width, valid, scene, flags, ray) JOIN(rtcOccluded, width)(valid, scene, flags, ray)
#endif

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)

/* ---- floating-point mode: Embree is written for denormals flushed to zero ---- */

#if defined(__SSE2__)
enum { FLUSH_AND_DENORMALS_ZERO = 0x8040 };
static unsigned flush_denormals(void) {
    unsigned before = _mm_getcsr();
    _mm_setcsr(before | FLUSH_AND_DENORMALS_ZERO);
    return before;
}
static void restore_mode(unsigned before) {
    /* The exception flags raised inside are dropped too. */
    _mm_setcsr(before);
}
bool luxel_embree_flushes_denormals(void) {
    return (_mm_getcsr() & FLUSH_AND_DENORMALS_ZERO) != 0;
}
#else
static unsigned flush_denormals(void) {
    return 0;
}
static void restore_mode(unsigned before) {
    (void)before;
}
bool luxel_embree_flushes_denormals(void) {
    return false;
}
#endif

/* ---- building ---- */

static float power_of_two(int exponent) {
    return ldexpf(1.0f, exponent);
}

/* The power of two that brings the largest coordinate into [1, 2). */
static int scale_exponent(const float *positions, size_t count) {
    float largest = 0.0f;
    for (size_t i = 0; i < count; i++) {
        float x = fabsf(positions[i]);
        largest = x > largest ? x : largest;
    }
    /* Limits: both the scale and its inverse must be normal numbers. */
    if (!(largest > 0.0f) || largest > FLT_MAX)
        return 0;
    int exponent = -ilogbf(largest);
    return exponent < -125 ? -125 : exponent > 125 ? 125 : exponent;
}

static enum RTCError fill_geometry(RTCGeometry geometry, const LuxelEmbree *tracer, const float *positions,
                                   size_t vertex_count, const uint32_t *triangles, size_t triangle_count) {
    /* Embree reads vertices 16 bytes at a time: one vertex more keeps the last read inside the buffer. */
    float *vertex = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                            3 * sizeof(float), vertex_count + 1);
    uint32_t *index = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                              3 * sizeof(uint32_t), triangle_count);
    if (!vertex || !index)
        return RTC_ERROR_OUT_OF_MEMORY;
    for (size_t i = 0; i < 3 * vertex_count; i++)
        vertex[i] = positions[i] * tracer->scale;
    memset(vertex + 3 * vertex_count, 0, 3 * sizeof(float));
    memcpy(index, triangles, 3 * triangle_count * sizeof(uint32_t));
    rtcSetGeometryBuildQuality(geometry, RTC_BUILD_QUALITY_HIGH);
    rtcCommitGeometry(geometry);
    return RTC_ERROR_NONE;
}

static enum RTCError build_scene(LuxelEmbree *tracer, const float *positions, size_t vertex_count,
                                 const uint32_t *triangles, size_t triangle_count) {
    tracer->scene = rtcNewScene(tracer->device);
    if (!tracer->scene)
        return rtcGetDeviceError(tracer->device);
    rtcSetSceneFlags(tracer->scene, RTC_SCENE_FLAG_ROBUST);
    rtcSetSceneBuildQuality(tracer->scene, RTC_BUILD_QUALITY_HIGH);
    if (triangle_count > 0) {
        RTCGeometry geometry = rtcNewGeometry(tracer->device, RTC_GEOMETRY_TYPE_TRIANGLE);
        if (!geometry)
            return rtcGetDeviceError(tracer->device);
        enum RTCError error =
            fill_geometry(geometry, tracer, positions, vertex_count, triangles, triangle_count);
        if (error != RTC_ERROR_NONE) {
            rtcReleaseGeometry(geometry);
            return error;
        }
        rtcAttachGeometry(tracer->scene, geometry);
        rtcReleaseGeometry(geometry);
    }
    rtcCommitScene(tracer->scene);
    /* Errors are kept per thread, and tracing reports none: this is the moment to ask. */
    return rtcGetDeviceError(tracer->device);
}

int32_t luxel_embree_new(const float *positions, size_t vertex_count, const uint32_t *triangles,
                         size_t triangle_count, LuxelEmbree **out) {
    LuxelEmbree *tracer = calloc(1, sizeof *tracer);
    if (!tracer)
        return RTC_ERROR_OUT_OF_MEMORY;
    int exponent = scale_exponent(positions, 3 * vertex_count);
    tracer->scale = power_of_two(exponent);
    tracer->unscale = power_of_two(-exponent);

    unsigned mode = flush_denormals();
    /* One build thread: several would order the triangles of a leaf by chance, and with them the ids at ties. */
    tracer->device = rtcNewDevice("threads=1,verbose=0");
    enum RTCError error = tracer->device
                              ? build_scene(tracer, positions, vertex_count, triangles, triangle_count)
                              : rtcGetDeviceError(NULL);
    restore_mode(mode);

    if (error != RTC_ERROR_NONE || !tracer->device) {
        luxel_embree_free(tracer);
        return error != RTC_ERROR_NONE ? error : RTC_ERROR_UNKNOWN;
    }
    *out = tracer;
    return 0;
}

void luxel_embree_free(LuxelEmbree *tracer) {
    if (!tracer)
        return;
    if (tracer->scene)
        rtcReleaseScene(tracer->scene);
    if (tracer->device)
        rtcReleaseDevice(tracer->device);
    free(tracer);
}

const char *luxel_embree_error_text(int32_t code) {
    switch (code) {
    case RTC_ERROR_NONE:
        return "no error";
    case RTC_ERROR_INVALID_ARGUMENT:
        return "invalid argument";
    case RTC_ERROR_INVALID_OPERATION:
        return "invalid operation";
    case RTC_ERROR_OUT_OF_MEMORY:
        return "out of memory";
    case RTC_ERROR_UNSUPPORTED_CPU:
        return "this processor is not supported";
    case RTC_ERROR_CANCELLED:
        return "cancelled";
    default:
        return "unknown error";
    }
}

void luxel_embree_info(const LuxelEmbree *tracer, LuxelEmbreeInfo *out) {
    RTCDevice device = tracer->device;
    out->major = (uint32_t)rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_VERSION_MAJOR);
    out->minor = (uint32_t)rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_VERSION_MINOR);
    out->patch = (uint32_t)rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_VERSION_PATCH);
    out->native_width = rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_NATIVE_RAY16_SUPPORTED)  ? 16
                        : rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_NATIVE_RAY8_SUPPORTED) ? 8
                        : rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_NATIVE_RAY4_SUPPORTED) ? 4
                                                                                                  : 1;
}

void luxel_embree_layout(LuxelEmbreeLayout *out) {
    out->rays_size = sizeof(LuxelRays);
    out->rays_count_offset = offsetof(LuxelRays, count);
    out->rays_coherent_offset = offsetof(LuxelRays, coherent);
    out->hit_size = sizeof(LuxelHit);
    out->hit_face_offset = offsetof(LuxelHit, face);
    out->info_size = sizeof(LuxelEmbreeInfo);
}

/* ---- one ray, brought into the units of the scene ---- */

typedef struct Lane {
    float org_x, org_y, org_z, dir_x, dir_y, dir_z, tnear, tfar;
    /* t of the caller = t of Embree * to_caller, a power of two. */
    float to_caller;
    int valid; /* -1 or 0, as Embree's masks */
} Lane;

static inline uint32_t bits(float x) {
    uint32_t b;
    memcpy(&b, &x, sizeof b);
    return b;
}

static inline float from_bits(uint32_t b) {
    float x;
    memcpy(&x, &b, sizeof x);
    return x;
}

static inline float max_of(float a, float b) {
    return a > b ? a : b;
}

/* Free of branches, so that the packet loops vectorise. */
static inline Lane load_lane(const LuxelEmbree *tracer, const LuxelRays *rays, size_t i) {
    Lane lane;
    float dx = rays->direction_x[i], dy = rays->direction_y[i], dz = rays->direction_z[i];
    float ox = rays->origin_x[i], oy = rays->origin_y[i], oz = rays->origin_z[i];
    float t_min = rays->t_min[i], t_max = rays->t_max[i];

    /* The direction's largest component goes to [1, 2) by a power of two: Embree clamps tiny directions. */
    uint32_t exponent = bits(max_of(fabsf(dx), max_of(fabsf(dy), fabsf(dz)))) & 0x7f800000u;
    float length = from_bits(exponent), shrink = from_bits(0x7f000000u - exponent);
    lane.dir_x = dx * shrink, lane.dir_y = dy * shrink, lane.dir_z = dz * shrink;
    lane.org_x = ox * tracer->scale, lane.org_y = oy * tracer->scale, lane.org_z = oz * tracer->scale;
    lane.to_caller = tracer->unscale * shrink;

    /* t_min < t < t_max becomes tnear <= t <= tfar on the neighbouring floats; denormals are zero to Embree. */
    float to_embree = tracer->scale * length;
    float near = t_min * to_embree, far = t_max * to_embree;
    lane.tnear = max_of(from_bits(bits(near) + 1), FLT_MIN);
    lane.tfar = from_bits(bits(far) - 1);

    /* Zero times anything finite is zero, times infinity or NaN is NaN. */
    float finite = (ox + oy + oz) * 0.0f + (dx + dy + dz) * 0.0f + near * 0.0f;
    /* Embree's own limit is 1.8e18: beyond, builds with assertions end the program. */
    float farthest = max_of(fabsf(lane.org_x), max_of(fabsf(lane.org_y), fabsf(lane.org_z)));
    bool valid = (finite == 0.0f) & (farthest <= 1e18f) & (exponent != 0) & (exponent < 0x7f000000u) & (far > near) &
                 (lane.tfar >= lane.tnear);
    lane.valid = valid ? -1 : 0;
    return lane;
}

static inline LuxelHit no_hit(void) {
    return (LuxelHit){.t = INFINITY, .u = 0.0f, .v = 0.0f, .face = UINT32_MAX};
}

static inline uint32_t face_of(uint32_t triangle, float normal_dot_direction) {
    return triangle << 1 | (normal_dot_direction > 0.0f ? 1u : 0u);
}

/* ---- single rays ---- */

static inline struct RTCRay single_ray(const Lane *lane) {
    return (struct RTCRay){.org_x = lane->org_x,
                           .org_y = lane->org_y,
                           .org_z = lane->org_z,
                           .tnear = lane->tnear,
                           .dir_x = lane->dir_x,
                           .dir_y = lane->dir_y,
                           .dir_z = lane->dir_z,
                           .tfar = lane->tfar,
                           .mask = UINT32_MAX};
}

static void closest_hits_1(const LuxelEmbree *tracer, const LuxelRays *rays, LuxelHit *hits) {
    ClosestFlags flags = closest_flags(rays->coherent);
    for (size_t i = 0; i < rays->count; i++) {
        Lane lane = load_lane(tracer, rays, i);
        hits[i] = no_hit();
        if (!lane.valid)
            continue;
        struct RTCRayHit packet;
        packet.ray = single_ray(&lane);
        packet.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        packet.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
        INTERSECT1(tracer->scene, &flags, &packet);
        if (packet.hit.geomID == RTC_INVALID_GEOMETRY_ID)
            continue;
        float side = packet.hit.Ng_x * lane.dir_x + packet.hit.Ng_y * lane.dir_y + packet.hit.Ng_z * lane.dir_z;
        hits[i] = (LuxelHit){.t = packet.ray.tfar * lane.to_caller,
                             .u = packet.hit.u,
                             .v = packet.hit.v,
                             .face = face_of(packet.hit.primID, side)};
    }
}

static void occluded_1(const LuxelEmbree *tracer, const LuxelRays *rays, uint8_t *occluded) {
    OccludedFlags flags = occluded_flags(rays->coherent);
    for (size_t i = 0; i < rays->count; i++) {
        Lane lane = load_lane(tracer, rays, i);
        occluded[i] = 0;
        if (!lane.valid)
            continue;
        struct RTCRay ray = single_ray(&lane);
        OCCLUDED1(tracer->scene, &flags, &ray);
        /* A valid ray has tfar > 0; Embree says "occluded" by a negative one. */
        occluded[i] = ray.tfar < 0.0f;
    }
}

/* ---- guard bytes ---- */

enum { GUARD = 256, GUARD_BYTE = 0xA5 };

static void set_guards(unsigned char *block, size_t size) {
    memset(block, GUARD_BYTE, GUARD);
    memset(block + GUARD + size, GUARD_BYTE, GUARD);
}

static bool guards_intact(const unsigned char *block, size_t size) {
    for (size_t i = 0; i < GUARD; i++)
        if (block[i] != GUARD_BYTE || block[GUARD + size + i] != GUARD_BYTE)
            return false;
    return true;
}

/* ---- packets ---- */

/* Packets are written by vectors as wide as those that Embree reads them with: a read that spans several younger
   writes waits for all of them to reach the cache. Compiled for several processors, chosen when the library is
   loaded; contraction is off, so that all compute the same bits. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__)
#define WIDEST __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define WIDEST
#endif

#define WIDTH 4
#include "embree_packet.h"
#undef WIDTH
#define WIDTH 8
#include "embree_packet.h"
#undef WIDTH
#define WIDTH 16
#include "embree_packet.h"
#undef WIDTH

void luxel_embree_closest_hits(const LuxelEmbree *tracer, const LuxelRays *rays, uint32_t width, LuxelHit *hits) {
    unsigned mode = flush_denormals();
    switch (width) {
    case 4:
        closest_hits_4(tracer, rays, hits);
        break;
    case 8:
        closest_hits_8(tracer, rays, hits);
        break;
    case 16:
        closest_hits_16(tracer, rays, hits);
        break;
    default:
        closest_hits_1(tracer, rays, hits);
    }
    restore_mode(mode);
}

void luxel_embree_occluded(const LuxelEmbree *tracer, const LuxelRays *rays, uint32_t width, uint8_t *occluded) {
    unsigned mode = flush_denormals();
    switch (width) {
    case 4:
        occluded_4(tracer, rays, occluded);
        break;
    case 8:
        occluded_8(tracer, rays, occluded);
        break;
    case 16:
        occluded_16(tracer, rays, occluded);
        break;
    default:
        occluded_1(tracer, rays, occluded);
    }
    restore_mode(mode);
}

/* ---- what there is to gain ---- */

static uint32_t bare_1(const LuxelEmbree *tracer, const LuxelRays *rays) {
    ClosestFlags flags = closest_flags(rays->coherent);
    uint32_t sum = 0;
    for (size_t i = 0; i < rays->count; i++) {
        struct RTCRayHit packet;
        packet.ray = (struct RTCRay){.org_x = rays->origin_x[i] * tracer->scale,
                                     .org_y = rays->origin_y[i] * tracer->scale,
                                     .org_z = rays->origin_z[i] * tracer->scale,
                                     .dir_x = rays->direction_x[i],
                                     .dir_y = rays->direction_y[i],
                                     .dir_z = rays->direction_z[i],
                                     .tfar = INFINITY,
                                     .mask = UINT32_MAX};
        packet.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        packet.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
        packet.hit.primID = 0;
        INTERSECT1(tracer->scene, &flags, &packet);
        sum += packet.hit.primID;
    }
    return sum;
}

uint32_t luxel_embree_bare(const LuxelEmbree *tracer, const LuxelRays *rays, uint32_t width) {
    unsigned mode = flush_denormals();
    uint32_t sum = width == 4    ? bare_4(tracer, rays)
                   : width == 8  ? bare_8(tracer, rays)
                   : width == 16 ? bare_16(tracer, rays)
                                 : bare_1(tracer, rays);
    restore_mode(mode);
    return sum;
}

/* ---- self-test ---- */

static bool guards_survive_1(const LuxelEmbree *tracer) {
    _Alignas(64) unsigned char block[GUARD + sizeof(struct RTCRayHit) + GUARD];
    _Alignas(64) unsigned char shadow[GUARD + sizeof(struct RTCRay) + GUARD];
    struct RTCRayHit *packet = (struct RTCRayHit *)(block + GUARD);
    struct RTCRay *ray = (struct RTCRay *)(shadow + GUARD);
    set_guards(block, sizeof *packet);
    set_guards(shadow, sizeof *ray);
    *ray = (struct RTCRay){.dir_x = 1.0f, .tfar = INFINITY, .mask = UINT32_MAX};
    packet->ray = *ray;
    packet->hit.geomID = RTC_INVALID_GEOMETRY_ID;
    packet->hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    ClosestFlags closest = closest_flags(false);
    OccludedFlags any = occluded_flags(false);
    INTERSECT1(tracer->scene, &closest, packet);
    OCCLUDED1(tracer->scene, &any, ray);
    return guards_intact(block, sizeof *packet) && guards_intact(shadow, sizeof *ray);
}

bool luxel_embree_guards_survive(const LuxelEmbree *tracer, uint32_t width) {
    unsigned mode = flush_denormals();
    bool survive = width == 4    ? guards_survive_4(tracer)
                   : width == 8  ? guards_survive_8(tracer)
                   : width == 16 ? guards_survive_16(tracer)
                                 : guards_survive_1(tracer);
    restore_mode(mode);
    return survive;
}
