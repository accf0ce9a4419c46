//! Direct light against closed forms, and the promises of the estimator.

use std::f32::consts::PI;

use glam::{DVec3, Quat, Vec3};
use luxel::{
    Scene,
    light::{LightSet, irradiance},
    options::Backend,
    sampling,
    scene::RAY_OFFSET,
    scene::SurfacePoint,
    scene::{Corners, Frame, Light, Material, Triangle, light::Environment},
    trace::{self, RayTracer},
};

/// A scene in the local frame, built by hand.
struct Builder(Scene);

impl Builder {
    fn new() -> Builder {
        Builder(Scene {
            proxy: None,
            name: "test".into(),
            frame: Frame { origin: DVec3::ZERO, scale: 1.0 },
            positions: vec![],
            triangles: vec![],
            corners: Corners::default(),
            materials: vec![Material::default()],
            textures: vec![],
            meshes: vec!["mesh".into()],
            lights: vec![],
            camera: None,
            warnings: vec![],
            sides: vec![],
            dropped: Default::default(),
        })
    }

    fn material(&mut self, emission: Vec3) -> u32 {
        self.0.materials.push(Material { emission, ..Material::default() });
        self.0.materials.len() as u32 - 1
    }

    fn triangle(&mut self, corners: [Vec3; 3], material: u32) {
        let first = self.0.positions.len() as u32;
        self.0.positions.extend(corners);
        let vertices = [first, first + 1, first + 2];
        self.0.triangles.push(Triangle { vertices, material, mesh: 0, two_sided: false, emits_back: false });
    }

    /// The front of corner, corner + u, corner + u + v, corner + v is on the side of u x v.
    fn quad(&mut self, corner: Vec3, u: Vec3, v: Vec3, material: u32) {
        self.triangle([corner, corner + u, corner + u + v], material);
        self.triangle([corner, corner + u + v, corner + v], material);
    }

    /// Walls of the box, seen from inside.
    fn room(&mut self, low: Vec3, high: Vec3) {
        let size = high - low;
        for axis in 0..3 {
            let (u, v) = (Vec3::AXES[(axis + 1) % 3] * size, Vec3::AXES[(axis + 2) % 3] * size);
            self.quad(low, u, v, 0);
            self.quad(low + Vec3::AXES[axis] * size, v, u, 0);
        }
    }

    fn light(mut self, light: Light) -> Builder {
        self.0.lights.push(light);
        self
    }

    fn at(&self, points: &[SurfacePoint], samples: u32, seed: u64) -> Vec<Vec3> {
        irradiance(&LightSet::new(&self.0), &*self.tracer(), points, 1, samples, seed).irradiance
    }

    fn tracer(&self) -> Box<dyn RayTracer> {
        trace::build(Backend::Brute, &self.0.geometry()).unwrap()
    }
}

fn point(position: Vec3, normal: Vec3) -> SurfacePoint {
    SurfacePoint { position, normal }
}

fn assert_close(got: f32, expected: f64, relative: f64, what: &str) {
    assert!((got as f64 - expected).abs() <= relative * expected.abs(), "{what}: {got}, expected {expected}");
}

/// Mean and its standard error over replicates.
fn statistics(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

/// Metres to local units in the CIE rooms: a power of two, walls inside [-0.5, 0.5].
const METRE: f32 = 0.125;

/// Rounding of the receiver's position and of f32 sums; the forms themselves are f64.
const ROUNDING: f64 = 1e-5;

#[test]
fn cie_5_3_area_source_in_a_black_room() {
    // 1 m2 source of pi * 1000 lm: radiance 1000 cd/m2. Once as a light, once as a surface just under the ceiling's hole.
    let expected_wall = [32.68, 75.19, 81.32, 69.06, 53.40, 40.00];
    let expected_floor = [61.42, 79.26, 95.67, 105.78];
    let at = |x: f32, y: f32, z: f32| Vec3::new(x - 2.0, y - 2.0, z - 1.5) * METRE;
    let mut points = vec![];
    for z in [2.75, 2.25, 1.75, 1.25, 0.75, 0.25] {
        points.push(point(at(2.0, 0.0, z), Vec3::Y));
    }
    for y in [0.25, 0.75, 1.25, 1.75] {
        points.push(point(at(2.0, y, 0.0), Vec3::Z));
    }
    let (corner, u, v) = (at(1.5, 1.5, 3.0), Vec3::Y * METRE, Vec3::X * METRE);

    let mut lamp = Builder::new();
    lamp.room(at(0.0, 0.0, 0.0), at(4.0, 4.0, 3.0));
    let lamp = lamp.light(Light::Rectangle { corner, edge_u: u, edge_v: v, radiance: Vec3::splat(1000.0) });
    let mut surface = Builder::new();
    surface.room(at(0.0, 0.0, 0.0), at(4.0, 4.0, 3.0));
    let emissive = surface.material(Vec3::splat(1000.0));
    surface.quad(corner - Vec3::Z * 1e-4 * METRE, u, v, emissive);

    for (builder, what) in [(&lamp, "rectangle"), (&surface, "surface")] {
        let result = builder.at(&points, 64, 1);
        let mut worst = 0.0_f64;
        for (e, expected) in result.iter().zip(expected_wall.iter().chain(&expected_floor)) {
            worst = worst.max((e.x as f64 / expected - 1.0).abs());
        }
        println!("CIE 5.3, {what}: largest error {:.4} %", 100.0 * worst);
        // The table has four digits: half a unit of 32.68 is 1.5e-4; lowering the surface by 0.1 mm shows at 2e-4.
        assert!(worst < 5e-4, "{what}: {worst}");
    }
}

#[test]
fn cie_5_4_walls_receive_all_of_an_isotropic_source() {
    let (low, high) = (Vec3::new(-2.0, -2.0, -1.5) * METRE, Vec3::new(2.0, 2.0, 1.5) * METRE);
    let mut b = Builder::new();
    b.room(low, high);
    let source = Vec3::new(0.3, -0.4, 0.2) * METRE;
    let intensity = 10_000.0 / (4.0 * PI) * METRE * METRE;
    let b = b.light(Light::Point { position: source, intensity: Vec3::splat(intensity), range: f32::INFINITY });
    // Midpoints of n x n cells of every wall.
    let n = 64;
    let (mut points, mut areas) = (vec![], vec![]);
    for t in 0..b.0.triangles.len() / 2 {
        let [a, q, c] = b.0.corners_of(2 * t);
        let [.., d] = b.0.corners_of(2 * t + 1);
        assert_eq!(q - a, c - d);
        for i in 0..n * n {
            let (s, r) = (((i % n) as f32 + 0.5) / n as f32, ((i / n) as f32 + 0.5) / n as f32);
            points.push(point(a + s * (q - a) + r * (d - a), b.0.normal(2 * t)));
            areas.push(2.0 * b.0.area(2 * t) / (n * n) as f64);
        }
    }
    let flux: f64 = b.at(&points, 64, 1).iter().zip(&areas).map(|(e, a)| e.x as f64 * a).sum();
    let flux = flux / (METRE as f64).powi(2);
    println!("CIE 5.4: {flux:.2} lm of 10000");
    // The midpoint rule's error is about (cell / distance)^2 / 24 where the wall is nearest (1.3 m): 1e-4.
    assert_close(flux as f32, 10_000.0, 1e-4, "flux");
    assert!((LightSet::new(&b.0).power()[1] / (METRE as f64).powi(2) - 10_000.0).abs() < 0.1);
}

#[test]
fn cie_5_8_direct_light_of_a_cube_turned_or_not() {
    let expected = [198.94, 142.35, 108.29, 64.22, 49.40];
    for turn in [Quat::IDENTITY, Quat::from_euler(glam::EulerRot::XYZ, 0.4, 1.1, 2.3)] {
        let mut b = Builder::new();
        b.room(Vec3::splat(-0.25), Vec3::splat(0.25));
        b.0.positions.iter_mut().for_each(|p| *p = turn * *p);
        let intensity = Vec3::splat(10_000.0 / (4.0 * PI) * METRE * METRE);
        let b = b.light(Light::Point { position: Vec3::ZERO, intensity, range: f32::INFINITY });
        let points = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (1.5, 1.5), (1.75, 1.75)]
            .map(|(x, y)| point(turn * Vec3::new(x * METRE, -0.25, y * METRE), turn * Vec3::Y));
        for (e, expected) in b.at(&points, 64, 1).iter().zip(expected) {
            // Two decimals: half a unit of 49.40 is 1e-4.
            assert_close(e.x, expected, 1.1e-4, "5.8");
        }
    }
}

/// A lamp over the origin and a half-plane between them that covers x > edge at half height.
fn half_covered(edge: f32) -> Builder {
    let mut b = Builder::new();
    b.quad(Vec3::new(edge, -0.5, 0.2), Vec3::X * (0.5 - edge), Vec3::Y, 0);
    b.light(Light::Rectangle {
        corner: Vec3::new(-0.1, -0.1, 0.4),
        edge_u: Vec3::Y * 0.2,
        edge_v: Vec3::X * 0.2,
        radiance: Vec3::new(1.0, 2.0, 3.0),
    })
}

/// Lambert's formula for a rectangle at height h over a horizontal receiver, as the difference of corner rectangles.
fn over_point(x0: f64, x1: f64, y0: f64, y1: f64, h: f64) -> f64 {
    let corner = |x: f64, y: f64| {
        let (x, y, sign) = ((x / h).abs(), (y / h).abs(), x.signum() * y.signum());
        let part = |a: f64, b: f64| a / (1.0 + a * a).sqrt() * (b / (1.0 + a * a).sqrt()).atan();
        sign * 0.5 * (part(x, y) + part(y, x))
    };
    corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0)
}

#[test]
fn a_half_plane_hides_its_share_of_a_lamp() {
    let up = point(Vec3::ZERO, Vec3::Z);
    for edge in [-0.04, 0.0, 0.013, 0.037] {
        let b = half_covered(edge);
        // Seen from the origin the edge falls on the lamp at twice its x.
        let expected = over_point(-0.1, 2.0 * edge as f64, -0.1, 0.1, 0.4);
        let values: Vec<f64> = (0..400).map(|seed| b.at(&[up], 16, seed)[0].x as f64).collect();
        let (mean, error) = statistics(&values);
        assert!((mean - expected).abs() < 4.0 * error + ROUNDING * expected, "{edge}: {mean} +- {error}, {expected}");
        // Random points would leave a spread of sqrt(p (1-p) / 16), 0.12 of the whole at half cover.
        let whole = over_point(-0.1, 0.1, -0.1, 0.1, 0.4);
        assert!(error * 20.0 < 0.08 * whole, "{edge}: spread {}", error * 20.0 / whole);
    }
}

#[test]
fn a_lamp_in_full_view_has_no_noise_and_a_covered_one_no_light() {
    let up = point(Vec3::ZERO, Vec3::Z);
    let covered = half_covered(-0.4).at(&[up], 64, 3)[0];
    assert_eq!(covered, Vec3::ZERO);
    let open = half_covered(0.2).at(&[up], 4, 3)[0];
    let expected = over_point(-0.1, 0.1, -0.1, 0.1, 0.4);
    for (channel, factor) in open.to_array().into_iter().zip([1.0, 2.0, 3.0]) {
        assert_close(channel, factor * expected, ROUNDING, "open");
    }
}

/// Rays end short of a lamp, so those of the room pass what lies on it; a sheet nearer than that was once lit as well.
#[test]
fn a_sheet_on_a_lamp_takes_none_of_its_light_or_hides_it() {
    // Half of a lamp in the floor lies under a sheet.
    let lamp = [[0.25, 0.25], [0.75, 0.25], [0.75, 0.75], [0.25, 0.75]].map(|[x, y]| Vec3::new(x, y, 0.0) - 0.5);
    let lights = LightSet::of_polygons([(&lamp[..], Vec3::ONE)].into_iter());
    let emitted = std::f64::consts::PI * 0.25;
    for height in [0.3 * RAY_OFFSET, 3.0 * RAY_OFFSET] {
        let mut b = Builder::new();
        b.room(Vec3::splat(-0.5), Vec3::splat(0.5));
        let corner = lamp[0] + Vec3::Z * height;
        b.quad(corner, Vec3::X * 0.5, Vec3::Y * 0.25, 0);
        let tracer = b.tracer();
        let n = 24;
        let cells = (0..n * n).map(|i| [(i % n) as f32 + 0.5, (i / n) as f32 + 0.5].map(|x| x / n as f32));
        let power = |corner: Vec3, u: Vec3, v: Vec3| {
            let normal = u.cross(v).normalize();
            let points: Vec<SurfacePoint> = cells.clone().map(|[s, t]| point(corner + s * u + t * v, normal)).collect();
            let light = irradiance(&lights, &*tracer, &points, 1, 64, 1).irradiance;
            light.iter().map(|e| e.x as f64).sum::<f64>() / (n * n) as f64 * u.cross(v).length() as f64
        };
        let (low, high) = (Vec3::splat(-0.5), Vec3::splat(0.5));
        let walls: f64 = (0..3)
            .flat_map(|axis| {
                let (u, v) = (Vec3::AXES[(axis + 1) % 3], Vec3::AXES[(axis + 2) % 3]);
                [power(low, u, v), power(high, -v, -u)]
            })
            .sum();
        let underside = power(corner, Vec3::Y * 0.25, Vec3::X * 0.5);
        println!("{height:e}: walls {walls}, underside {underside}, emitted {emitted}");
        // The midpoint rule errs by 1/24 of the square of a cell over the distance of lamp and walls, 0.1 %.
        let error = ((walls + underside) / emitted - 1.0).abs();
        assert!(error < 0.01, "{height:e}: {walls} + {underside} of {emitted}");
        assert_eq!(underside > 0.0, height > RAY_OFFSET);
    }
}

/// Bright patches are lamps that are receivers too.
#[test]
fn a_turned_lamp_gives_no_light_to_its_own_plane() {
    let mut b = Builder::new();
    b.room(Vec3::splat(-0.5), Vec3::splat(0.5));
    let tracer = b.tracer();
    for k in 0..300 {
        let random = |i: u64| (sampling::hash(&[7, k, i]) >> 40) as f32 / (1u64 << 24) as f32 - 0.5;
        let vector = |i: u64| Vec3::new(random(i), random(i + 1), random(i + 2));
        let normal = vector(0).normalize();
        let (u, v) = sampling::frame(normal);
        let corner = 0.7 * vector(3);
        let lamp = [corner, corner + 0.016 * u, corner + 0.016 * (u + v), corner + 0.016 * v];
        let lights = LightSet::of_polygons([(&lamp[..], Vec3::ONE)].into_iter());
        // On the lamp, and on a neighbour in its plane.
        let points: Vec<SurfacePoint> = (0..64)
            .map(|i| [random(10 + 2 * i) + 0.5, 2.0 * (random(11 + 2 * i) + 0.5)])
            .map(|[s, t]| point(lamp[0] + s * (lamp[1] - lamp[0]) + t * (lamp[3] - lamp[0]), normal))
            .collect();
        let light = irradiance(&lights, &*tracer, &points, 1, 16, 1).irradiance;
        assert!(
            light.iter().all(|e| *e == Vec3::ZERO),
            "lamp {k}: {:?}",
            light.iter().max_by(|a, b| a.x.total_cmp(&b.x))
        );
    }
}

#[test]
fn a_lamp_touching_the_receivers_plane_is_clipped_by_it() {
    // A vertical lamp that goes through the floor, and one that stands on it right beside the receiver.
    let lamp = |low: f32, x: f32| {
        Builder::new().light(Light::Rectangle {
            corner: Vec3::new(x, -0.2, low),
            edge_u: Vec3::Z * (0.3 - low),
            edge_v: Vec3::Y * 0.4,
            radiance: Vec3::ONE,
        })
    };
    for x in [0.1, 1e-3, 1e-6] {
        let up = point(Vec3::ZERO, Vec3::Z);
        let through = lamp(-0.3, x).at(&[up], 16, 1)[0].x;
        let standing = lamp(0.0, x).at(&[up], 16, 1)[0].x;
        assert_close(through, standing as f64, ROUNDING, "clipped");
        assert!(standing > 0.0 && standing <= 0.5 * PI, "{x}: {standing}");
    }
}

#[test]
fn a_blocker_close_to_a_touching_lamp_hides_its_share() {
    // The receiver is 0.02 under a lamp of 0.4 x 0.4; a half-plane between them hides x > 0.01. Area sampling would
    // put nearly all samples where they count little.
    let mut b = Builder::new();
    b.quad(Vec3::new(5e-3, -0.5, 0.01), Vec3::X * 0.495, Vec3::Y, 0);
    let (edge_u, edge_v) = (Vec3::Y * 0.4, Vec3::X * 0.4);
    let b = b.light(Light::Rectangle { corner: Vec3::new(-0.2, -0.2, 0.02), edge_u, edge_v, radiance: Vec3::ONE });
    let expected = over_point(-0.2, 0.01, -0.2, 0.2, 0.02);
    let values: Vec<f64> = (0..400).map(|seed| b.at(&[point(Vec3::ZERO, Vec3::Z)], 16, seed)[0].x as f64).collect();
    let (mean, error) = statistics(&values);
    // A share of weighted samples is biased by about (its spread)^2: squares of 0.1 over 16 samples.
    assert!((mean - expected).abs() < 4.0 * error + 1e-3 * expected, "{mean} +- {error}, {expected}");
    assert!(error * 20.0 < 0.12 * expected, "spread {}", error * 20.0 / expected);
}

#[test]
fn two_triangles_of_a_quad_are_one_lamp_with_one_share_of_rays() {
    let lamp = |shift: Vec3| {
        let mut b = Builder::new();
        let emissive = b.material(Vec3::ONE);
        let [p, q, r, s] = [(-0.1, -0.1), (-0.1, 0.1), (0.1, 0.1), (0.1, -0.1)].map(|(x, y)| Vec3::new(x, y, 0.3));
        b.triangle([p, q, r], emissive);
        b.triangle([p, r, s + shift], emissive);
        irradiance(&LightSet::new(&b.0), &*b.tracer(), &[point(Vec3::ZERO, Vec3::Z)], 1, 64, 1)
    };
    let (quad, pair) = (lamp(Vec3::ZERO), lamp(Vec3::X * 1e-4));
    assert_eq!(quad.rays, 64);
    // The halves of a pair that is no parallelogram get half each.
    assert_eq!(pair.rays, 32 + 32);
    let expected = over_point(-0.1, 0.1, -0.1, 0.1, 0.3);
    assert_close(quad.irradiance[0].x, expected, ROUNDING, "quad");
    assert_close(pair.irradiance[0].x, expected, 1e-3, "pair");
}

#[test]
fn lamps_light_their_front_and_their_back_only_if_told() {
    for both in [false, true] {
        let mut b = Builder::new();
        let emissive = b.material(Vec3::ONE);
        b.quad(Vec3::new(-0.1, -0.1, 0.0), Vec3::X * 0.2, Vec3::Y * 0.2, emissive);
        b.0.triangles.iter_mut().for_each(|t| (t.two_sided, t.emits_back) = (both, both));
        let e = b.at(&[point(Vec3::Z * 0.3, -Vec3::Z), point(Vec3::Z * -0.3, Vec3::Z)], 64, 1);
        let expected = over_point(-0.1, 0.1, -0.1, 0.1, 0.3);
        assert_close(e[0].x, expected, ROUNDING, "front");
        assert_close(e[1].x, if both { expected } else { 0.0 }, ROUNDING, "back");
        let sides = if both { 2.0 } else { 1.0 };
        assert!((LightSet::new(&b.0).power()[2] - sides * std::f64::consts::PI * 0.04).abs() < 1e-6);
    }
}

#[test]
fn a_disc_over_a_point_gives_pi_sine_squared() {
    let b =
        Builder::new().light(Light::Disc { centre: Vec3::Z * 0.3, normal: -Vec3::Z, radius: 0.2, radiance: Vec3::ONE });
    let e = b.at(&[point(Vec3::ZERO, Vec3::Z), point(Vec3::Z * 0.4, Vec3::Z)], 64, 1);
    assert_close(e[0].x, std::f64::consts::PI * 0.04 / (0.04 + 0.09), ROUNDING, "coaxial");
    assert_eq!(e[1], Vec3::ZERO, "behind the disc");
}

#[test]
fn spot_lights_fall_off_as_the_gltf_extension_says() {
    let (inner, outer) = (0.2_f32, 0.5_f32);
    let b = Builder::new().light(Light::Spot {
        position: Vec3::Z * 0.5,
        direction: -Vec3::Z,
        intensity: Vec3::ONE,
        cos_inner: inner.cos(),
        cos_outer: outer.cos(),
        range: f32::INFINITY,
    });
    let angles = [0.0, 0.1, 0.3, 0.45, 0.6_f32];
    let points = angles.map(|a| point(Vec3::X * 0.5 * a.tan(), Vec3::Z));
    for (e, angle) in b.at(&points, 1, 1).iter().zip(angles.map(f64::from)) {
        let (c, i, o) = (angle.cos(), (inner as f64).cos(), (outer as f64).cos());
        let fall = ((c - o) / (i - o)).clamp(0.0, 1.0).powi(2);
        assert!((e.x as f64 - fall * c.powi(3) / 0.25).abs() < 1e-4, "{angle}: {e}");
    }
    // 2 pi times the integral of the fall-off over the cosine.
    let power = LightSet::new(&b.0).power()[0];
    let (i, o) = (inner.cos() as f64, outer.cos() as f64);
    assert!((power - 2.0 * std::f64::consts::PI * (1.0 - i + (i - o) / 3.0)).abs() < 1e-6);
}

#[test]
fn a_sun_gives_the_cosine_and_its_shadow_nothing() {
    let mut b = Builder::new();
    b.quad(Vec3::new(-0.5, -0.5, 0.2), Vec3::X * 0.5, Vec3::Y, 0);
    let b = b.light(Light::Sun { direction: Vec3::new(0.0, 0.6, -0.8), irradiance: Vec3::splat(10.0) });
    let e = b.at(&[point(Vec3::X * 0.1, Vec3::Z), point(Vec3::X * -0.1, Vec3::Z)], 64, 1);
    assert_close(e[0].x, 8.0, ROUNDING, "sun");
    assert_eq!(e[1], Vec3::ZERO);
}

fn environment(width: u32, height: u32, f: impl Fn(u32, u32) -> f32) -> Light {
    let texels = (0..width * height).map(|i| Vec3::splat(f(i % width, i / width))).collect();
    Light::Environment(Environment { width, height, texels, up: Vec3::Z })
}

#[test]
fn an_open_sky_gives_pi_times_its_radiance_and_a_constant_image_the_same() {
    let points = [point(Vec3::ZERO, Vec3::Z), point(Vec3::ZERO, Vec3::new(0.6, 0.0, -0.8))];
    let sky = Builder::new().light(Light::Sky { radiance: Vec3::splat(2.0) });
    let image = Builder::new().light(environment(16, 8, |_, _| 2.0));
    for e in sky.at(&points, 64, 1).into_iter().chain(image.at(&points, 64, 1)) {
        assert_close(e.x, 2.0 * std::f64::consts::PI, ROUNDING, "open sky");
    }
}

#[test]
fn a_floor_hides_the_lower_half_of_the_sky_from_a_wall() {
    // A vertical receiver above a floor far larger than its height sees half of its hemisphere.
    let mut b = Builder::new();
    b.quad(Vec3::new(-0.5, -0.5, 0.0), Vec3::X, Vec3::Y, 0);
    let b = b.light(Light::Sky { radiance: Vec3::ONE });
    let h = 1e-3_f32;
    let values: Vec<f64> = (0..200).map(|seed| b.at(&[point(Vec3::Z * h, Vec3::X)], 64, seed)[0].x as f64).collect();
    let (mean, error) = statistics(&values);
    // The floor ends at 500 heights: it hides less than the half by under 1 / 500 of it.
    let half = 0.5 * std::f64::consts::PI;
    assert!((mean - half).abs() < 4.0 * error + half / 500.0, "{mean} +- {error}");
}

#[test]
fn a_bright_texel_is_a_sun() {
    // One texel of 256 x 128: solid angle and direction are known, so is the irradiance.
    let (width, height, x, y) = (256, 128, 200, 30);
    let radiance = 1e5_f32;
    let b = Builder::new().light(environment(width, height, |i, j| if (i, j) == (x, y) { radiance } else { 0.01 }));
    let cosine = |row: f64| (std::f64::consts::PI * row / height as f64).cos();
    let (top, bottom) = (cosine(y as f64), cosine(y as f64 + 1.0));
    let solid_angle = 2.0 * std::f64::consts::PI / width as f64 * (top - bottom);
    let mean_height = 0.5 * (top + bottom);
    let expected = radiance as f64 * solid_angle * mean_height + 0.01 * std::f64::consts::PI;
    let up = point(Vec3::ZERO, Vec3::Z);
    let values: Vec<f64> = (0..100).map(|seed| b.at(&[up], 64, seed)[0].x as f64).collect();
    let (mean, error) = statistics(&values);
    assert!((mean - expected).abs() < 4.0 * error + 1e-4 * expected, "{mean} +- {error}, {expected}");
    // Cosine rays alone would have a spread of 16 times the value (they meet the texel once in 2e4).
    assert!(error * 10.0 < 0.02 * expected, "spread {}", error * 10.0 / expected);
    // And a roof hides it.
    let mut roofed = b;
    roofed.quad(Vec3::new(-0.5, -0.5, 1e-3), Vec3::X, Vec3::Y, 0);
    assert!(roofed.at(&[up], 64, 1)[0].x < 1e-3 * expected as f32);
}

/// Many small lamps of different strength, area and direction in a room with a wall.
fn many_lamps(count: u32) -> Builder {
    let mut b = Builder::new();
    b.room(Vec3::splat(-0.5), Vec3::splat(0.5));
    b.quad(Vec3::new(0.0, -0.5, -0.5), Vec3::Y, Vec3::Z * 0.6, 0);
    let unit = |i: u32, k: u64| sampling::hash(&[i as u64, k]) as f32 / u64::MAX as f32;
    for i in 0..count {
        let centre = Vec3::new(unit(i, 0), unit(i, 1), unit(i, 2)) * 0.9 - 0.45;
        let strength = Vec3::new(1.0, 2.0, unit(i, 9)) * 10f32.powf(2.0 * unit(i, 3));
        if i % 3 == 0 {
            b.0.lights.push(Light::Point { position: centre, intensity: strength * 1e-4, range: f32::INFINITY });
        } else {
            let turn = Quat::from_euler(glam::EulerRot::XYZ, 6.0 * unit(i, 4), 6.0 * unit(i, 5), 6.0 * unit(i, 6));
            let (u, v) = (turn * Vec3::X * 0.01, turn * Vec3::Y * 0.01);
            b.0.lights.push(Light::Rectangle { corner: centre, edge_u: u, edge_v: v, radiance: strength });
        }
    }
    b
}

#[test]
fn picking_among_thousands_of_lamps_is_unbiased() {
    let b = many_lamps(2000);
    let points = [
        point(Vec3::new(-0.3, 0.1, -0.5), Vec3::Z),
        point(Vec3::new(0.2, 0.1, -0.1), Vec3::new(0.6, 0.0, -0.8)),
        point(Vec3::new(0.5, -0.2, 0.3), -Vec3::X),
    ];
    // The full sum: each lamp alone, many rays. Its own error is from the few penumbrae.
    let tracer = b.tracer();
    let mut full = [DVec3::ZERO; 3];
    for light in &b.0.lights {
        let mut one = Builder::new();
        one.0.lights.push(light.clone());
        let lights = LightSet::new(&one.0);
        for (sum, e) in full.iter_mut().zip(irradiance(&lights, &*tracer, &points, 1, 64, 1).irradiance) {
            *sum += e.as_dvec3();
        }
    }
    let lights = LightSet::new(&b.0);
    let runs: Vec<Vec<Vec3>> =
        (0..300).map(|seed| irradiance(&lights, &*tracer, &points, 1, 64, seed).irradiance).collect();
    for (i, full) in full.iter().enumerate() {
        for channel in 0..3 {
            let values: Vec<f64> = runs.iter().map(|run| run[i][channel] as f64).collect();
            let (mean, error) = statistics(&values);
            let z = (mean - full[channel]) / error;
            println!(
                "point {i} channel {channel}: {mean:.4} of {:.4}, z {z:.2}, spread {:.3}",
                full[channel],
                error * 300f64.sqrt() / mean
            );
            assert!(z.abs() < 4.0, "point {i} channel {channel}: {mean} +- {error}, {}", full[channel]);
        }
    }
    let rays = irradiance(&lights, &*tracer, &points, 1, 64, 1).rays;
    assert!(rays < 3 * 300, "{rays} rays for three points and 2000 lamps");
}

#[test]
fn the_lamp_beside_a_point_is_not_left_to_chance_among_many() {
    // Equal lamps that look down, and points under some of them, so close that the others hardly count.
    let mut b = Builder::new();
    let unit = |i: u64, k: u64| sampling::hash(&[i, k]) as f32 / u64::MAX as f32;
    let places: Vec<Vec3> = (0..300).map(|i| Vec3::new(unit(i, 0), unit(i, 1), unit(i, 2)) * 0.9 - 0.45).collect();
    const SIZE: f32 = 0.01;
    for &corner in &places {
        let (edge_u, edge_v) = (Vec3::Y * SIZE, Vec3::X * SIZE);
        b.0.lights.push(Light::Rectangle { corner, edge_u, edge_v, radiance: Vec3::ONE });
    }
    let (lights, tracer) = (LightSet::new(&b.0), b.tracer());
    for (i, &lamp) in places.iter().enumerate().step_by(10) {
        let x = point(lamp + 0.5 * SIZE * Vec3::new(1.0, 1.0, -1.0), Vec3::Z);
        let of_lamp = |k: usize| {
            let mut one = Builder::new();
            one.0.lights.push(b.0.lights[k].clone());
            irradiance(&LightSet::new(&one.0), &*tracer, &[x], 1, 1, 1).irradiance[0].x as f64
        };
        let beside = of_lamp(i);
        let others: f64 = (0..places.len()).filter(|&k| k != i).map(of_lamp).sum();
        let values: Vec<f64> =
            (0..50).map(|seed| irradiance(&lights, &*tracer, &[x], 1, 64, seed).irradiance[0].x as f64).collect();
        let (mean, error) = statistics(&values);
        // Picks among the others err by less than all that they give; a pick that misses the near one, by that.
        assert!(error * 50f64.sqrt() < others, "lamp {i}: {mean} +- {error}, {beside} and {others}");
        assert!((mean - beside - others).abs() < 4.0 * error + ROUNDING * mean, "lamp {i}: {mean} +- {error}");
        assert!(others < 0.2 * beside, "lamp {i}: {beside} and {others}");
    }
}

#[test]
fn a_patch_has_the_mean_light_of_its_points() {
    // A patch of 0.1 x 0.1 half in the shadow of the blocker, against many single points.
    let b = half_covered(0.03);
    let (lights, tracer) = (LightSet::new(&b.0), b.tracer());
    let place = |u: f32, v: f32| point(Vec3::new(0.1 * u - 0.1, 0.1 * v, 0.0), Vec3::Z);
    let n = 32;
    let fine: Vec<SurfacePoint> =
        (0..n * n).map(|i| place(((i % n) as f32 + 0.5) / n as f32, ((i / n) as f32 + 0.5) / n as f32)).collect();
    let exact = irradiance(&lights, &*tracer, &fine, 1, 256, 1).irradiance;
    let exact = exact.iter().map(|e| e.x as f64).sum::<f64>() / exact.len() as f64;
    let values: Vec<f64> = (0..200)
        .map(|seed| {
            let points: Vec<SurfacePoint> = (0..32)
                .map(|k| {
                    let [u, v, ..] = sampling::sobol4(k, seed);
                    place(u, v)
                })
                .collect();
            let result = irradiance(&lights, &*tracer, &points, 32, 32, seed);
            assert_eq!(result.irradiance.len(), 1);
            result.irradiance[0].x as f64
        })
        .collect();
    let (mean, error) = statistics(&values);
    println!("patch: {mean} +- {error}, exact {exact}, spread {}", error * 200f64.sqrt() / exact);
    // The reference's own error: 1024 points of 256 stratified rays, below 1e-3.
    assert!((mean - exact).abs() < 4.0 * error + 1e-3 * exact, "{mean} +- {error}, {exact}");
    assert!(error * 200f64.sqrt() < 0.03 * exact);
}

#[test]
fn a_folded_patch_beside_a_lamp_has_no_more_noise_than_random_points() {
    // A sheet of two sides: one faces a lamp close by, both are faced by others far away.
    let mut b = Builder::new();
    let lamp = Vec3::new(-0.02, -0.02, 0.05);
    b.0.lights.push(Light::Rectangle {
        corner: lamp,
        edge_u: Vec3::Y * 0.04,
        edge_v: Vec3::X * 0.04,
        radiance: Vec3::ONE,
    });
    for i in 0..8 {
        let position = Vec3::new(0.3 * (i % 3) as f32 - 0.3, 0.1, if i % 2 == 0 { 0.4 } else { -0.4 });
        b.0.lights.push(Light::Point { position, intensity: Vec3::splat(1e-4), range: f32::INFINITY });
    }
    let place = |u: f32, v: f32| {
        let side = if u < 0.5 { 1.0 } else { -1.0 };
        point(Vec3::new(0.1 * (2.0 * u % 1.0) - 0.05, 0.1 * v - 0.05, 0.0), Vec3::Z * side)
    };
    let (lights, tracer) = (LightSet::new(&b.0), b.tracer());
    // Nothing hides anything, so that one ray a point gives its exact light.
    let fine: Vec<SurfacePoint> =
        (0..64 * 64).map(|i| place(((i % 64) as f32 + 0.5) / 64.0, ((i / 64) as f32 + 0.5) / 64.0)).collect();
    let exact = irradiance(&lights, &*tracer, &fine, 1, 1, 1).irradiance;
    let (exact, of_fine) = statistics(&exact.iter().map(|e| e.x as f64).collect::<Vec<_>>());
    let of_one = of_fine * (fine.len() as f64).sqrt();

    let patch = |seed| {
        let points: Vec<SurfacePoint> =
            (0..32).map(|k| sampling::sobol4(k, seed)).map(|[u, v, ..]| place(u, v)).collect();
        irradiance(&lights, &*tracer, &points, 32, 32, seed).irradiance[0].x as f64
    };
    let (mean, error) = statistics(&(0..200).map(patch).collect::<Vec<_>>());
    let spread = error * 200f64.sqrt();
    println!("{mean} +- {error}, exact {exact}; spread {spread}, of random points {}", of_one / 32f64.sqrt());
    // The midpoint rule is good to the cells' curvature, far below 1e-3.
    assert!((mean - exact).abs() < 4.0 * error + 1e-3 * exact, "{mean} +- {error}, {exact}");
    assert!(spread < of_one / 32f64.sqrt(), "{spread} {of_one}");
}

#[test]
fn a_bent_patch_among_many_lamps_has_the_mean_light_of_its_points() {
    // Points on a quarter of a cylinder, so that no lamp is in view of all of them.
    let b = many_lamps(500);
    let (lights, tracer) = (LightSet::new(&b.0), b.tracer());
    let place = |u: f32, v: f32| {
        let (sin, cos) = (0.5 * PI * u).sin_cos();
        point(Vec3::new(-0.3 + 0.1 * cos, 0.1 * sin, 0.2 * v - 0.1), Vec3::new(cos, sin, 0.0))
    };
    let points: Vec<SurfacePoint> = (0..64).map(|k| sampling::sobol4(k, 3)).map(|[u, v, ..]| place(u, v)).collect();
    let single = |seed| {
        let e = irradiance(&lights, &*tracer, &points, 1, 64, seed).irradiance;
        e.iter().map(|e| e.x as f64).sum::<f64>() / points.len() as f64
    };
    let (exact, exact_error) = statistics(&(0..20).map(single).collect::<Vec<_>>());
    let patch = |seed| irradiance(&lights, &*tracer, &points, 64, 64, seed).irradiance[0].x as f64;
    let (mean, error) = statistics(&(0..200).map(patch).collect::<Vec<_>>());
    println!("bent patch: {mean} +- {error}, points {exact} +- {exact_error}");
    assert!((mean - exact).abs() < 4.0 * error.hypot(exact_error), "{mean} +- {error}, {exact} +- {exact_error}");
}

#[test]
fn answers_do_not_depend_on_threads_or_on_neighbours_in_the_list() {
    let b = many_lamps(100).light(Light::Sky { radiance: Vec3::ONE });
    let (lights, tracer) = (LightSet::new(&b.0), b.tracer());
    let points: Vec<SurfacePoint> = (0..300)
        .map(|i| {
            let [u, v, w, _] = sampling::sobol4(i, 5);
            point(Vec3::new(u, v, w) - 0.5, Vec3::new(v, w, u).normalize())
        })
        .collect();
    let run = |threads: usize, points: &[SurfacePoint]| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| irradiance(&lights, &*tracer, points, 1, 16, 7))
    };
    let one = run(1, &points);
    assert_eq!(one, run(2, &points));
    assert_eq!(one, run(5, &points));
    let reversed: Vec<SurfacePoint> = points.iter().rev().copied().collect();
    let mut back = run(2, &reversed).irradiance;
    back.reverse();
    assert_eq!(one.irradiance, back);
    assert_eq!(run(1, &points[17..18]).irradiance[0], one.irradiance[17]);
    // Zeros of either sign are the same place and direction.
    let zeros = |zero: f32| [point(Vec3::new(0.1, zero, 0.1), Vec3::new(1.0, zero, zero))];
    assert_eq!(run(1, &zeros(0.0)), run(1, &zeros(-0.0)));
    // Another seed is another estimate.
    assert_ne!(one.irradiance, irradiance(&lights, &*tracer, &points, 1, 16, 8).irradiance);
}

#[test]
fn senseless_input_gives_finite_light() {
    let nan = Vec3::splat(f32::NAN);
    let bad = [
        Light::Rectangle { corner: Vec3::ZERO, edge_u: Vec3::X, edge_v: Vec3::X, radiance: Vec3::ONE },
        Light::Rectangle { corner: nan, edge_u: Vec3::X, edge_v: Vec3::Y, radiance: Vec3::ONE },
        Light::Disc { centre: Vec3::ZERO, normal: Vec3::ZERO, radius: 1.0, radiance: Vec3::ONE },
        Light::Disc { centre: Vec3::ZERO, normal: Vec3::Z, radius: 0.0, radiance: Vec3::ONE },
        Light::Point { position: Vec3::ZERO, intensity: nan, range: 1.0 },
        Light::Point { position: Vec3::ZERO, intensity: Vec3::ONE, range: 0.0 },
        Light::Sun { direction: Vec3::ZERO, irradiance: Vec3::ONE },
        Light::Sky { radiance: nan },
        Light::Environment(Environment { width: 2, height: 2, texels: vec![], up: Vec3::Z }),
    ];
    let mut b = Builder::new();
    b.0.lights.extend(bad);
    assert!(LightSet::new(&b.0).is_empty());

    // Receivers on, in and beside the lights; and ones that are no surface points at all.
    let b = b
        .light(Light::Point { position: Vec3::ZERO, intensity: Vec3::ONE, range: f32::INFINITY })
        .light(Light::Disc { centre: Vec3::ZERO, normal: Vec3::Z, radius: 0.3, radiance: Vec3::ONE })
        .light(Light::Rectangle { corner: Vec3::ZERO, edge_u: Vec3::X, edge_v: Vec3::Y, radiance: Vec3::ONE })
        .light(Light::Sky { radiance: Vec3::new(f32::MAX, 0.0, 1.0) })
        .light(environment(2, 2, |_, _| f32::MAX))
        .light(Light::Point { position: Vec3::X, intensity: Vec3::new(f32::MAX, 0.0, 1.0), range: 2.0 })
        .light(Light::Rectangle { corner: Vec3::ZERO, edge_u: Vec3::X * 1e-20, edge_v: Vec3::Y, radiance: Vec3::ONE });
    let mut points = vec![point(nan, Vec3::Z), point(Vec3::ZERO, nan), point(Vec3::ZERO, Vec3::ZERO)];
    for normal in [Vec3::Z, -Vec3::Z, Vec3::X, Vec3::new(0.6, 0.0, -0.8)] {
        for position in [Vec3::ZERO, Vec3::X * 0.3, Vec3::Z * 1e-30, Vec3::Z * 1e-7, Vec3::new(0.2, 0.2, 1e-5)] {
            points.push(point(position, normal));
        }
    }
    for (e, x) in b.at(&points, 16, 1).iter().zip(&points) {
        assert!(e.is_finite() && e.min_element() >= 0.0, "{x:?}: {e}");
    }
    let none = irradiance(&LightSet::new(&b.0), &*b.tracer(), &[], 0, 0, 1);
    assert!(none.irradiance.is_empty() && none.rays == 0);
}

#[test]
fn without_surfaces_the_other_lights_stay() {
    let mut b = Builder::new();
    let emissive = b.material(Vec3::ONE);
    b.quad(Vec3::new(-0.1, -0.1, 0.3), Vec3::Y * 0.2, Vec3::X * 0.2, emissive);
    let b = b.light(Light::Sun { direction: -Vec3::Z, irradiance: Vec3::ONE });
    let all = LightSet::new(&b.0);
    assert!((all.power()[0] - std::f64::consts::PI * 0.04).abs() < 1e-6);
    let rest = all.without_surfaces();
    assert!(!rest.is_empty());
    assert_eq!(rest.power(), [0.0; 3]);
    let e = irradiance(&rest, &*b.tracer(), &[point(Vec3::X * 0.3, Vec3::Z)], 1, 4, 1).irradiance[0];
    assert_eq!(e, Vec3::ONE);
}
