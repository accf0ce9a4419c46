//! Every ray tracer answers alike: each case runs on brute force, obvhs and, where compiled in, Embree in all widths.

use glam::{DVec3, Vec3};
use luxel::trace::{Brute, Bvh, Geometry, Hit, RayBatch, RayTracer};
use rand::Rng;

/// A small generator with a fixed seed, so that a failure repeats.
mod rand {
    pub struct Rng(u64);

    impl Rng {
        pub fn new(seed: u64) -> Rng {
            Rng(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
        }

        /// Uniform in [0, 1): xorshift64*, the upper 24 bits.
        pub fn unit(&mut self) -> f32 {
            self.0 ^= self.0 >> 12;
            self.0 ^= self.0 << 25;
            self.0 ^= self.0 >> 27;
            (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 40) as f32 / (1 << 24) as f32
        }

        pub fn between(&mut self, low: f32, high: f32) -> f32 {
            low + (high - low) * self.unit()
        }

        pub fn point(&mut self, r: f32) -> glam::Vec3 {
            glam::Vec3::new(self.between(-r, r), self.between(-r, r), self.between(-r, r))
        }
    }
}

type Make = fn(&Geometry) -> Box<dyn RayTracer>;

/// Runs `case` once a backend.
macro_rules! on_every_backend {
    ($($(#[$doc:meta])* fn $name:ident($make:ident) $body:block)*) => {$(
        mod $name {
            use super::*;

            fn case($make: Make) $body

            #[test]
            fn brute() {
                case(|g| Box::new(Brute::new(g)));
            }

            #[test]
            fn bvh() {
                case(|g| Box::new(Bvh::new(g).unwrap()));
            }

            #[cfg(feature = "embree")]
            mod embree {
                use luxel::trace::Embree;

                #[test]
                fn width_1() {
                    super::case(|g| Box::new(Embree::new(g).unwrap().with_width(1).unwrap()));
                }

                #[test]
                fn width_4() {
                    super::case(|g| Box::new(Embree::new(g).unwrap().with_width(4).unwrap()));
                }

                #[test]
                fn width_8() {
                    super::case(|g| Box::new(Embree::new(g).unwrap().with_width(8).unwrap()));
                }

                #[test]
                fn width_16() {
                    super::case(|g| Box::new(Embree::new(g).unwrap().with_width(16).unwrap()));
                }
            }
        }
    )*};
}

/// Triangles of size about `size` in a cube of half width 1.
fn soup(rng: &mut Rng, n: usize, size: f32) -> Geometry {
    let mut g = Geometry::default();
    for k in 0..n as u32 {
        let centre = rng.point(1.0);
        g.positions.extend((0..3).map(|_| centre + rng.point(size)));
        g.triangles.push([3 * k, 3 * k + 1, 3 * k + 2]);
    }
    g
}

fn random_rays(rng: &mut Rng, n: usize) -> RayBatch {
    let mut rays = RayBatch::default();
    for _ in 0..n {
        let length = 10f32.powf(rng.between(-2.0, 2.0));
        rays.push(rng.point(1.5), rng.point(length), 0.0, f32::INFINITY);
    }
    rays
}

fn trace(tracer: &dyn RayTracer, rays: &RayBatch) -> Vec<Hit> {
    let mut hits = vec![Hit::NONE; rays.len()];
    tracer.closest_hits(rays, &mut hits);
    hits
}

fn shadow(tracer: &dyn RayTracer, rays: &RayBatch) -> Vec<bool> {
    let mut occluded = vec![false; rays.len()];
    tracer.occluded(rays, &mut occluded);
    occluded
}

/// One ray.
fn ray(origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> RayBatch {
    let mut rays = RayBatch::default();
    rays.push(origin, direction, t_min, t_max);
    rays
}

fn assert_sane(rays: &RayBatch, hits: &[Hit], triangles: usize) {
    for (i, hit) in hits.iter().enumerate() {
        if hit.is_hit() {
            assert!(hit.triangle() < triangles);
            assert!(hit.t > rays.t_min[i] && hit.t < rays.t_max[i], "ray {i}: {hit:?}");
            assert!(hit.u.is_finite() && hit.v.is_finite(), "ray {i}: {hit:?}");
        } else {
            assert_eq!(*hit, Hit::NONE);
        }
    }
}

/// Largest relative difference of t that rounding explains.
///
/// t = n.(a - o) / n.d, where the f32 rounding of a - o, of n and of the two products costs some 10 half ulps of the
/// numbers that go in, |a - o| <= 5 against a distance d.t; a grazing ray divides that by |n.d|/(|n||d|).
fn t_tolerance(g: &Geometry, rays: &RayBatch, i: usize, hit: &Hit) -> f64 {
    let [a, b, c] = g.triangles[hit.triangle()].map(|v| g.positions[v as usize].as_dvec3());
    let (e1, e2) = (b - a, c - a);
    let (n, d) = (e1.cross(e2), rays.direction(i).as_dvec3());
    // A thin triangle has an imprecise normal.
    let thin = e1.length() * e2.length() / n.length();
    let grazing = n.length() * d.length() / n.dot(d).abs();
    20.0 * f32::EPSILON as f64 * 5.0 * thin * grazing / d.length()
}

/// Compares with the oracle; returns how many rays disagree beyond rounding.
fn disagreements(g: &Geometry, rays: &RayBatch, hits: &[Hit], oracle: &[Hit]) -> usize {
    let differ = |i: &usize| {
        let (hit, truth) = (&hits[*i], &oracle[*i]);
        match (hit.is_hit(), truth.is_hit()) {
            (false, false) => false,
            (true, true) => {
                let tolerance = t_tolerance(g, rays, *i, hit).max(t_tolerance(g, rays, *i, truth));
                let same_t = (hit.t as f64 - truth.t as f64).abs() <= tolerance + 4e-7 * truth.t as f64;
                !same_t || hit.triangle() == truth.triangle() && hit.is_back() != truth.is_back()
            }
            // One sees a triangle that the other passes: by an edge, or not at all. Counted.
            _ => true,
        }
    };
    (0..rays.len()).filter(differ).count()
}

on_every_backend! {
    fn random_soups_are_seen_alike(make) {
        for (seed, n, size) in [(1, 1, 0.9), (2, 2, 0.5), (3, 17, 0.5), (4, 300, 0.2), (5, 3000, 0.05)] {
            let mut rng = Rng::new(seed);
            let g = soup(&mut rng, n, size);
            let mut rays = random_rays(&mut rng, 2000);
            let oracle = trace(&Brute::new(&g), &rays);
            assert!(oracle.iter().any(Hit::is_hit) && oracle.iter().any(|h| !h.is_hit()));
            let tracer = make(&g);
            for coherent in [false, true] {
                rays.coherent = coherent;
                let hits = trace(&*tracer, &rays);
                assert_sane(&rays, &hits, n);
                let wrong = disagreements(&g, &rays, &hits, &oracle);
                // A ray within rounding of an edge may go either way. Edges of length s cover about s * 1e-6 of a
                // scene of size 2: a ray meets such a strip with probability 1e-6 a triangle in its way.
                assert!(wrong <= 1, "{n} triangles: {wrong} of {} rays differ", rays.len());
                let ids = hits.iter().zip(&oracle).filter(|(a, b)| a.face != b.face).count();
                assert!(ids <= 1, "{n} triangles: {ids} ids differ");
                let any = shadow(&*tracer, &rays);
                let unlike = any.iter().zip(&hits).filter(|(o, h)| **o != h.is_hit()).count();
                assert_eq!(unlike, 0, "{n} triangles: occlusion and closest hits differ");
            }
        }
    }

    fn barycentric_coordinates_give_the_point_of_the_hit(make) {
        let mut rng = Rng::new(11);
        let g = soup(&mut rng, 50, 0.5);
        let rays = random_rays(&mut rng, 1000);
        for (i, hit) in trace(&*make(&g), &rays).iter().enumerate().filter(|(_, h)| h.is_hit()) {
            let [a, b, c] = g.triangles[hit.triangle()].map(|v| g.positions[v as usize].as_dvec3());
            let on_triangle = a + (b - a) * hit.u as f64 + (c - a) * hit.v as f64;
            let on_ray = rays.origin(i).as_dvec3() + rays.direction(i).as_dvec3() * hit.t as f64;
            let tolerance = t_tolerance(&g, &rays, i, hit) * rays.direction(i).length() as f64 + 1e-5;
            assert!(on_triangle.distance(on_ray) < tolerance, "ray {i}: {on_triangle} and {on_ray}");
            let normal: DVec3 = (b - a).cross(c - a);
            assert_eq!(hit.is_back(), normal.dot(rays.direction(i).as_dvec3()) > 0.0, "ray {i}");
        }
    }

    fn no_triangles_are_never_hit(make) {
        let rays = random_rays(&mut Rng::new(21), 19);
        for g in [Geometry::default(), Geometry { positions: vec![Vec3::ONE], triangles: vec![] }] {
            let tracer = make(&g);
            assert!(trace(&*tracer, &rays).iter().all(|h| *h == Hit::NONE));
            assert!(!shadow(&*tracer, &rays).contains(&true));
        }
    }

    fn an_empty_batch_has_no_answers(make) {
        let tracer = make(&soup(&mut Rng::new(22), 5, 0.5));
        assert!(trace(&*tracer, &RayBatch::default()).is_empty());
        assert!(shadow(&*tracer, &RayBatch::default()).is_empty());
    }

    fn a_ray_has_the_same_answer_in_batches_of_every_length(make) {
        let mut rng = Rng::new(23);
        let tracer = make(&soup(&mut rng, 200, 0.3));
        let all = random_rays(&mut rng, 33);
        let (hits, any) = (trace(&*tracer, &all), shadow(&*tracer, &all));
        for n in 1..=33 {
            let mut rays = RayBatch::default();
            (0..n).for_each(|i| rays.push(all.origin(i), all.direction(i), all.t_min[i], all.t_max[i]));
            assert_eq!(trace(&*tracer, &rays), hits[..n]);
            assert_eq!(shadow(&*tracer, &rays), any[..n]);
        }
    }

    fn both_ends_of_the_interval_are_exclusive(make) {
        let g = Geometry { positions: vec![-Vec3::ONE, Vec3::new(3., -1., -1.), Vec3::new(-1., 3., -1.)], triangles: vec![[0, 1, 2]] };
        let tracer = make(&g);
        let hit = |origin: Vec3, direction: Vec3, t_min: f32, t_max: f32| {
            let rays = ray(origin, direction, t_min, t_max);
            let hit = trace(&*tracer, &rays)[0];
            assert_eq!(shadow(&*tracer, &rays)[0], hit.is_hit());
            hit
        };
        for length in [1.0f32, 0.25, 1024.0, 1e-20, 1e15] {
            let (o, d) = (Vec3::new(0.0, 0.0, 2.0), Vec3::new(0.0, 0.0, -length));
            let t = hit(o, d, 0.0, f32::INFINITY).t;
            assert!((t * length - 3.0).abs() < 2e-6, "{t} at length {length}");
            assert!(!hit(o, d, t, f32::INFINITY).is_hit(), "t_min is exclusive at length {length}");
            assert!(!hit(o, d, 0.0, t).is_hit(), "t_max is exclusive at length {length}");
            // Two steps, as a backend may lose the neighbouring float to a half-open interval.
            let (below, above) = (t.next_down().next_down(), t.next_up().next_up());
            assert!(hit(o, d, below, f32::INFINITY).is_hit(), "length {length}");
            assert!(hit(o, d, 0.0, above).is_hit(), "length {length}");
            assert!(!hit(o, d, above, below).is_hit(), "an empty interval holds nothing");
        }
        // A ray that starts on the triangle does not hit it at t = 0.
        assert!(!hit(Vec3::new(0.0, 0.0, -1.0), Vec3::Z, 0.0, f32::INFINITY).is_hit());
        assert!(!hit(Vec3::new(0.0, 0.0, 2.0), Vec3::NEG_Z, 0.0, 0.0).is_hit());
    }

    fn near_hits_count_at_every_scale(make) {
        for scale in [1e-12f32, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e12] {
            let g = soup(&mut Rng::new(31), 40, 0.5);
            let g = Geometry { positions: g.positions.iter().map(|p| *p * scale).collect(), ..g };
            let mut rays = random_rays(&mut Rng::new(32), 300);
            for i in 0..rays.len() {
                // Unit directions, so that t shrinks with the scene.
                let d = rays.direction(i).normalize();
                (rays.direction_x[i], rays.direction_y[i], rays.direction_z[i]) = (d.x, d.y, d.z);
                rays.origin_x[i] *= scale;
                rays.origin_y[i] *= scale;
                rays.origin_z[i] *= scale;
            }
            let hits = trace(&*make(&g), &rays);
            let oracle = trace(&Brute::new(&g), &rays);
            assert_sane(&rays, &hits, 40);
            let differ = hits.iter().zip(&oracle).filter(|(a, b)| a.face != b.face).count();
            assert!(differ <= 1, "scale {scale}: {differ} of {} differ", rays.len());
        }
    }

    fn degenerate_triangles_are_harmless(make) {
        let mut g = soup(&mut Rng::new(41), 20, 0.5);
        let p = g.positions[4];
        let n = g.positions.len() as u32;
        // Points, a line of three points, and two equal triangles.
        g.positions.extend([p, p, p, Vec3::X, Vec3::X * 2.0, Vec3::X * 3.0]);
        g.triangles.extend([[n, n + 1, n + 2], [7, 7, 7], [7, 7, 8], [n + 3, n + 4, n + 5], [0, 1, 2]]);
        let mut rays = random_rays(&mut Rng::new(42), 1000);
        let tracer = make(&g);
        let hits = trace(&*tracer, &rays);
        assert!(disagreements(&g, &rays, &hits, &trace(&Brute::new(&g), &rays)) <= 1);
        // Along the line and through the point.
        rays.push(Vec3::ZERO, Vec3::X, 0.0, f32::INFINITY);
        rays.push(p - Vec3::Y, Vec3::Y, 0.0, f32::INFINITY);
        let hits = trace(&*tracer, &rays);
        assert_sane(&rays, &hits, g.triangles.len());
        assert!(!hits.iter().any(|h| h.is_hit() && (20..24).contains(&h.triangle())), "a degenerate triangle was hit");
    }

    fn many_equal_triangles_build_and_are_hit(make) {
        let one = soup(&mut Rng::new(43), 1, 0.9);
        let g = Geometry { positions: one.positions.clone(), triangles: vec![[0, 1, 2]; 5000] };
        let centre = one.positions.iter().sum::<Vec3>() / 3.0;
        let rays = ray(centre + Vec3::Z, Vec3::NEG_Z, 0.0, f32::INFINITY);
        assert!(trace(&*make(&g), &rays)[0].is_hit());
    }

    fn axis_parallel_rays_hit_the_faces_of_a_box(make) {
        let tracer = make(&closed_box(4));
        for (axis, side) in (0..3).flat_map(|a| [(a, 1.0f32), (a, -1.0)]) {
            for (i, j) in (0..9).flat_map(|i| (0..9).map(move |j| (i, j))) {
                // Many of these pass exactly through edges and vertices; 0.0 and -0.0 both occur.
                let (p, q) = (i as f32 / 4.0 - 1.0, j as f32 / 4.0 - 1.0);
                let mut origin = Vec3::ZERO;
                let mut direction = Vec3::splat(if (i + j) % 2 == 0 { 0.0 } else { -0.0 });
                direction[axis] = side;
                (origin[(axis + 1) % 3], origin[(axis + 2) % 3]) = (p, q);
                let hit = trace(&*tracer, &ray(origin, direction, 0.0, f32::INFINITY))[0];
                // On the rim the ray runs inside a side face, where either answer is right.
                if p.abs() < 1.0 && q.abs() < 1.0 {
                    assert!((hit.t - 1.0).abs() < 1e-6, "axis {axis}, side {side}, at {p}, {q}: {hit:?}");
                }
            }
        }
    }

    fn no_ray_leaves_a_closed_box_through_its_edges(make) {
        let n = 6;
        let g = closed_box(n);
        let tracer = make(&g);
        let mut rng = Rng::new(51);
        let mut rays = RayBatch::default();
        for _ in 0..20 {
            let o = rng.point(0.7);
            for t in &g.triangles {
                let [a, b, c] = t.map(|v| g.positions[v as usize]);
                // At vertices, at edges' middles and anywhere on edges.
                for target in [a, (a + b) / 2.0, a + (c - a) * rng.unit(), b + (c - b) * rng.unit()] {
                    rays.push(o, target - o, 0.0, f32::INFINITY);
                }
            }
        }
        // The oracle's own edge test is not made to be watertight; everything else must be.
        if tracer.name() != "brute force" {
            let leaks = trace(&*tracer, &rays).iter().filter(|h| !h.is_hit()).count();
            assert_eq!(leaks, 0, "of {}", rays.len());
            assert!(shadow(&*tracer, &rays).iter().all(|&o| o));
        }
    }

    fn rays_that_are_not_finite_or_have_no_direction_meet_nothing(make) {
        let tracer = make(&closed_box(1));
        let mut rays = RayBatch::default();
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            rays.push(Vec3::new(bad, 0.0, 0.0), Vec3::X, 0.0, f32::INFINITY);
            rays.push(Vec3::ZERO, Vec3::new(0.0, bad, 0.0), 0.0, f32::INFINITY);
        }
        rays.push(Vec3::ZERO, Vec3::ZERO, 0.0, f32::INFINITY);
        rays.push(Vec3::ZERO, Vec3::X, f32::NAN, f32::INFINITY);
        rays.push(Vec3::ZERO, Vec3::X, 0.0, f32::NAN);
        let n = rays.len();
        rays.push(Vec3::ZERO, Vec3::X, 0.0, f32::INFINITY);
        let hits = trace(&*tracer, &rays);
        assert!(hits[..n].iter().all(|h| *h == Hit::NONE), "{hits:?}");
        assert!(hits[n].is_hit(), "a sound ray among them is traced");
        assert_eq!(shadow(&*tracer, &rays), hits.iter().map(Hit::is_hit).collect::<Vec<_>>());
    }
}

/// The cube [-1, 1]^3 with n x n quads a side, sharing no vertices between quads but the same coordinates.
fn closed_box(n: usize) -> Geometry {
    let mut g = Geometry::default();
    let at = |i: usize| i as f32 * 2.0 / n as f32 - 1.0;
    for (axis, side) in (0..3).flat_map(|a| [(a, 1.0f32), (a, -1.0)]) {
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let corner = |p: usize, q: usize| {
                let mut v = Vec3::ZERO;
                (v[axis], v[(axis + 1) % 3], v[(axis + 2) % 3]) = (side, at(p), at(q));
                v
            };
            let k = g.positions.len() as u32;
            g.positions.extend([corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)]);
            g.triangles.extend([[k, k + 1, k + 2], [k, k + 2, k + 3]]);
        }
    }
    g
}

#[test]
fn a_geometry_that_cannot_be_traced_is_refused_by_every_backend() {
    use luxel::options::Backend;
    let far = Geometry { positions: vec![Vec3::ZERO; 3], triangles: vec![[0, 1, 3]] };
    let nan = Geometry { positions: vec![Vec3::NAN; 3], triangles: vec![[0, 1, 2]] };
    for backend in [Backend::Auto, Backend::Embree, Backend::Bvh, Backend::Brute] {
        assert!(luxel::trace::build(backend, &far).is_err(), "{backend:?}");
        assert!(luxel::trace::build(backend, &nan).is_err(), "{backend:?}");
    }
}

#[test]
fn auto_takes_embree_where_it_is_compiled_in_and_says_so() {
    let g = closed_box(1);
    let tracer = luxel::trace::build(luxel::options::Backend::Auto, &g).unwrap();
    let expected = if cfg!(feature = "embree") { "embree " } else { "obvhs " };
    assert!(tracer.name().starts_with(expected), "{}", tracer.name());
    assert!(!tracer.instruction_set().is_empty());
}
