/* The packet queries, written once and included for every WIDTH. Part of embree_shim.c. */

#define NAME(stem) JOIN(stem, WIDTH)
#define RAYS NAME(RTCRay)
#define RAYHITS NAME(RTCRayHit)

/* Fills lanes 0..n of the packet; the rest of a tail is masked off, with an empty interval besides. */
static inline void NAME(load_)(const LuxelEmbree *tracer, const LuxelRays *rays, size_t first, size_t n,
                               struct RAYS *restrict packet, int *restrict valid, float *restrict to_caller) {
    if (n < WIDTH) {
        memset(packet, 0, sizeof *packet);
        memset(to_caller, 0, WIDTH * sizeof *to_caller);
        for (size_t i = 0; i < WIDTH; i++) {
            valid[i] = 0;
            packet->tnear[i] = INFINITY;
            packet->tfar[i] = -INFINITY;
        }
    }
    /* The usual, full packet has a constant trip count, which the compiler unrolls into vector loads. */
    size_t count = n < WIDTH ? n : WIDTH;
    for (size_t i = 0; i < count; i++) {
        Lane lane = load_lane(tracer, rays, first + i);
        packet->org_x[i] = lane.org_x;
        packet->org_y[i] = lane.org_y;
        packet->org_z[i] = lane.org_z;
        packet->tnear[i] = lane.tnear;
        packet->dir_x[i] = lane.dir_x;
        packet->dir_y[i] = lane.dir_y;
        packet->dir_z[i] = lane.dir_z;
        packet->time[i] = 0.0f;
        packet->tfar[i] = lane.tfar;
        packet->mask[i] = UINT32_MAX;
        packet->id[i] = 0;
        packet->flags[i] = 0;
        valid[i] = lane.valid;
        to_caller[i] = lane.to_caller;
    }
}

/* The results of the first n lanes. Free of branches, and apart from the interleaving, so that both vectorise. A lane
   that was masked off keeps the preset id. */
static inline void NAME(store_)(const struct RAYHITS *restrict packet, const float *restrict to_caller, size_t n,
                                LuxelHit *hits) {
    _Alignas(64) float t[WIDTH], u[WIDTH], v[WIDTH], face[WIDTH];
    for (size_t i = 0; i < WIDTH; i++) {
        float side = packet->hit.Ng_x[i] * packet->ray.dir_x[i] + packet->hit.Ng_y[i] * packet->ray.dir_y[i] +
                     packet->hit.Ng_z[i] * packet->ray.dir_z[i];
        uint32_t hit = packet->hit.geomID[i] == RTC_INVALID_GEOMETRY_ID ? 0 : UINT32_MAX;
        t[i] = from_bits((bits(packet->ray.tfar[i] * to_caller[i]) & hit) | (bits(INFINITY) & ~hit));
        u[i] = from_bits(bits(packet->hit.u[i]) & hit);
        v[i] = from_bits(bits(packet->hit.v[i]) & hit);
        face[i] = from_bits(face_of(packet->hit.primID[i], side) | ~hit);
    }
    float out[WIDTH][4];
    for (size_t i = 0; i < WIDTH; i++) {
        out[i][0] = t[i];
        out[i][1] = u[i];
        out[i][2] = v[i];
        out[i][3] = face[i];
    }
    memcpy(hits, out, n * sizeof *hits);
}

WIDEST static void NAME(closest_hits_)(const LuxelEmbree *tracer, const LuxelRays *rays, LuxelHit *hits) {
    ClosestFlags flags = closest_flags(rays->coherent);
    _Alignas(64) struct RAYHITS packet;
    _Alignas(64) int valid[WIDTH];
    _Alignas(64) float to_caller[WIDTH];
    memset(&packet.hit, 0, sizeof packet.hit);
    for (size_t first = 0; first < rays->count; first += WIDTH) {
        size_t n = rays->count - first < WIDTH ? rays->count - first : WIDTH;
        if (n == WIDTH)
            NAME(load_)(tracer, rays, first, WIDTH, &packet.ray, valid, to_caller);
        else
            NAME(load_)(tracer, rays, first, n, &packet.ray, valid, to_caller);
        for (size_t i = 0; i < WIDTH; i++) {
            packet.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
            packet.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
        }
        INTERSECT(WIDTH, valid, tracer->scene, &flags, &packet);
        if (n == WIDTH)
            NAME(store_)(&packet, to_caller, WIDTH, hits + first);
        else
            NAME(store_)(&packet, to_caller, n, hits + first);
    }
}

WIDEST static void NAME(occluded_)(const LuxelEmbree *tracer, const LuxelRays *rays, uint8_t *occluded) {
    OccludedFlags flags = occluded_flags(rays->coherent);
    _Alignas(64) struct RAYS packet;
    _Alignas(64) int valid[WIDTH];
    _Alignas(64) float to_caller[WIDTH];
    for (size_t first = 0; first < rays->count; first += WIDTH) {
        size_t n = rays->count - first < WIDTH ? rays->count - first : WIDTH;
        if (n == WIDTH)
            NAME(load_)(tracer, rays, first, WIDTH, &packet, valid, to_caller);
        else
            NAME(load_)(tracer, rays, first, n, &packet, valid, to_caller);
        OCCLUDED(WIDTH, valid, tracer->scene, &flags, &packet);
        /* A masked lane may have had a negative tfar from the start. */
        for (size_t i = 0; i < n; i++)
            occluded[first + i] = valid[i] && packet.tfar[i] < 0.0f;
    }
}

WIDEST static uint32_t NAME(bare_)(const LuxelEmbree *tracer, const LuxelRays *rays) {
    ClosestFlags flags = closest_flags(rays->coherent);
    _Alignas(64) struct RAYHITS packet;
    _Alignas(64) int valid[WIDTH];
    memset(&packet, 0, sizeof packet);
    for (size_t i = 0; i < WIDTH; i++) {
        valid[i] = -1;
        packet.ray.mask[i] = UINT32_MAX;
    }
    uint32_t sums[WIDTH] = {0}, sum = 0;
    for (size_t first = 0; first + WIDTH <= rays->count; first += WIDTH) {
        for (size_t i = 0; i < WIDTH; i++) {
            packet.ray.org_x[i] = rays->origin_x[first + i] * tracer->scale;
            packet.ray.org_y[i] = rays->origin_y[first + i] * tracer->scale;
            packet.ray.org_z[i] = rays->origin_z[first + i] * tracer->scale;
            packet.ray.dir_x[i] = rays->direction_x[first + i];
            packet.ray.dir_y[i] = rays->direction_y[first + i];
            packet.ray.dir_z[i] = rays->direction_z[first + i];
            packet.ray.tfar[i] = INFINITY;
            packet.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
            packet.hit.primID[i] = 0;
        }
        INTERSECT(WIDTH, valid, tracer->scene, &flags, &packet);
        for (size_t i = 0; i < WIDTH; i++)
            sums[i] += packet.hit.primID[i];
    }
    for (size_t i = 0; i < WIDTH; i++)
        sum += sums[i];
    return sum;
}

static bool NAME(guards_survive_)(const LuxelEmbree *tracer) {
    _Alignas(64) unsigned char block[GUARD + sizeof(struct RAYHITS) + GUARD];
    _Alignas(64) unsigned char shadow[GUARD + sizeof(struct RAYS) + GUARD];
    _Alignas(64) int valid[WIDTH];
    struct RAYHITS *packet = (struct RAYHITS *)(block + GUARD);
    struct RAYS *rays = (struct RAYS *)(shadow + GUARD);
    set_guards(block, sizeof *packet);
    set_guards(shadow, sizeof *rays);
    memset(packet, 0, sizeof *packet);
    for (size_t i = 0; i < WIDTH; i++) {
        valid[i] = -1;
        packet->ray.dir_x[i] = 1.0f;
        packet->ray.tfar[i] = INFINITY;
        packet->ray.mask[i] = UINT32_MAX;
        packet->hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
        packet->hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
    }
    *rays = packet->ray;
    ClosestFlags closest = closest_flags(false);
    OccludedFlags any = occluded_flags(false);
    INTERSECT(WIDTH, valid, tracer->scene, &closest, packet);
    OCCLUDED(WIDTH, valid, tracer->scene, &any, rays);
    return guards_intact(block, sizeof *packet) && guards_intact(shadow, sizeof *rays);
}

#undef NAME
#undef RAYS
#undef RAYHITS
