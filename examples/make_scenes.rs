//! Writes the meshes in `scenes/` that are computed: `cargo run --example make_scenes [FOLDER]`.
//!
//! Rooms are the border of their air on a grid of planes, so that all faces meet edge to edge, nothing coincides and all
//! normals point into the air. z is up.

use std::{collections::BTreeMap, f64::consts::TAU, fmt::Write, path::Path};

type Point = [f64; 3];

fn main() -> std::io::Result<()> {
    let folder = std::env::args().nth(1).unwrap_or_else(|| concat!(env!("CARGO_MANIFEST_DIR"), "/scenes").into());
    for (name, text) in meshes() {
        std::fs::write(Path::new(&folder).join(name), text)?;
    }
    Ok(())
}

/// Names and texts of all computed meshes.
pub fn meshes() -> Vec<(&'static str, String)> {
    vec![
        ("cie_5_3.obj", cie_5_3()),
        ("cie_5_6_small.obj", cie_5_6(0.5)),
        ("cie_5_6_large.obj", cie_5_6(4.0)),
        ("cube.obj", cube()),
        ("sphere.obj", sphere_only()),
        ("curved_room.obj", curved_room()),
        ("two_rooms.obj", two_rooms()),
    ]
}

/// CIE 171:2006 test 5.3: 4 x 4 x 3 m, a source of 1 x 1 m in the middle of the ceiling.
fn cie_5_3() -> String {
    let mut obj = Obj::new("Room of CIE 171:2006 test 5.3; the answers stand in cie_5_3.toml.", "rooms.mtl");
    let planes = [0.0, 1.5, 2.5, 4.0];
    obj.room(&planes, &planes, &[0.0, 3.0], &|_, _, _| true, &|cell, normal| {
        if normal == [0, 0, -1] && cell == [1, 1, 0] { "lamp" } else { "black" }
    });
    obj.text
}

/// CIE 171:2006 test 5.6: a lit square on the floor and the black wall y = 0.
fn cie_5_6(side: f64) -> String {
    let mut obj = Obj::new("Surfaces of CIE 171:2006 test 5.6; the answers stand in the scene files.", "rooms.mtl");
    let (low, high) = (2.0 - 0.5 * side, 2.0 + 0.5 * side);
    obj.object("s2", "reflector");
    obj.face(&[[low, low, 0.0], [high, low, 0.0], [high, high, 0.0], [low, high, 0.0]]);
    obj.object("wall", "black");
    obj.face(&[[0.0, 0.0, 0.0], [0.0, 0.0, 3.0], [4.0, 0.0, 3.0], [4.0, 0.0, 0.0]]);
    obj.text
}

/// Cube of side 4 around the origin, seen from inside.
fn cube() -> String {
    let mut obj = Obj::new("A cube of side 4 around the origin; its normals point inwards.", "rooms.mtl");
    obj.room(&[-2.0, 2.0], &[-2.0, 2.0], &[-2.0, 2.0], &|_, _, _| true, &|_, _| "wall");
    obj.text
}

fn sphere_only() -> String {
    let mut obj =
        Obj::new("A sphere of radius 1 around the origin, 320 triangles; its normals point inwards.", "rooms.mtl");
    obj.object("sphere", "wall");
    // A negative radius turns the sphere inside out.
    obj.sphere([0.0; 3], -1.0, 2);
    obj.text
}

/// A closed room with a sphere, a torus and a tilted plank.
fn curved_room() -> String {
    let mut obj = Obj::new("A closed room with curved and tilted objects; see curved_room.toml.", "rooms.mtl");
    let planes = [0.0, 1.5, 2.5, 4.0];
    obj.room(&planes, &planes, &[0.0, 3.0], &|_, _, _| true, &|cell, normal| match normal {
        [0, 0, -1] if cell == [1, 1, 0] => "lamp",
        [1, 0, 0] => "red",
        [-1, 0, 0] => "green",
        _ => "wall",
    });
    obj.object("sphere", "wall");
    obj.sphere([1.1, 1.3, 0.7], 0.6, 3);
    obj.object("torus", "blue");
    obj.torus([2.8, 2.7, 0.6], 0.55, 0.2, 32, 16);
    obj.object("plank", "wall");
    obj.plank([2.7, 1.2, 0.9], [0.8, 0.15, 0.05], 35.0_f64.to_radians(), 50.0_f64.to_radians());
    obj.text
}

/// Two rooms of 3 x 3 x 3 m with a wall of 2 cm between them and a door of 0.8 x 2 m; only the first has a lamp.
fn two_rooms() -> String {
    let mut obj = Obj::new("Two rooms, a wall of 2 cm, a door gap; see two_rooms.toml.", "rooms.mtl");
    let (xs, ys, zs) = ([0.0, 1.0, 2.0, 2.99, 3.01, 6.0], [0.0, 1.0, 1.8, 3.0], [0.0, 2.0, 3.0]);
    let air = |x: usize, y: usize, z: usize| x != 3 || (y == 1 && z == 0);
    obj.room(&xs, &ys, &zs, &air, &|cell, normal| {
        if normal == [0, 0, -1] && cell == [1, 1, 1] { "lamp" } else { "wall" }
    });
    obj.text
}

/// Text of an OBJ file in the making; vertices of one object are shared.
struct Obj {
    text: String,
    vertices: BTreeMap<[i64; 3], usize>,
}

impl Obj {
    fn new(title: &str, library: &str) -> Obj {
        let text = format!("# {title}\n# Written by examples/make_scenes.rs.\nmtllib {library}\n");
        Obj { text, vertices: BTreeMap::new() }
    }

    fn object(&mut self, name: &str, material: &str) {
        writeln!(self.text, "o {name}\nusemtl {material}").unwrap();
    }

    /// Coordinates are rounded to a micrometre.
    fn vertex(&mut self, p: Point) -> usize {
        let key = p.map(|x| (x * 1e6).round() as i64);
        let next = self.vertices.len() + 1;
        *self.vertices.entry(key).or_insert_with(|| {
            let [x, y, z] = key.map(|k| k as f64 / 1e6);
            writeln!(self.text, "v {x} {y} {z}").unwrap();
            next
        })
    }

    fn face(&mut self, corners: &[Point]) {
        let indices: Vec<String> = corners.iter().map(|p| self.vertex(*p).to_string()).collect();
        writeln!(self.text, "f {}", indices.join(" ")).unwrap();
    }

    /// The border of the air cells of a grid; `material` is asked with the cell and the normal into it.
    fn room(
        &mut self,
        xs: &[f64],
        ys: &[f64],
        zs: &[f64],
        air: &dyn Fn(usize, usize, usize) -> bool,
        material: &dyn Fn([usize; 3], [i32; 3]) -> &'static str,
    ) {
        let planes = [xs, ys, zs];
        let cells = planes.map(|p| p.len() - 1);
        let is_air = |c: [i64; 3]| {
            (0..3).all(|a| c[a] >= 0 && c[a] < cells[a] as i64) && air(c[0] as usize, c[1] as usize, c[2] as usize)
        };
        let mut faces: BTreeMap<&str, Vec<[Point; 4]>> = BTreeMap::new();
        for (x, y, z) in
            (0..cells[0]).flat_map(|x| (0..cells[1]).flat_map(move |y| (0..cells[2]).map(move |z| (x, y, z))))
        {
            let cell = [x, y, z];
            if !is_air(cell.map(|c| c as i64)) {
                continue;
            }
            for axis in 0..3 {
                for up in [false, true] {
                    let mut beyond = cell.map(|c| c as i64);
                    beyond[axis] += if up { 1 } else { -1 };
                    if is_air(beyond) {
                        continue;
                    }
                    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                    let corner = |du: usize, dv: usize| {
                        let mut p = [0.0; 3];
                        p[axis] = planes[axis][cell[axis] + usize::from(up)];
                        p[u] = planes[u][cell[u] + du];
                        p[v] = planes[v][cell[v] + dv];
                        p
                    };
                    let mut quad = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                    if up {
                        quad.reverse();
                    }
                    let mut normal = [0; 3];
                    normal[axis] = if up { -1 } else { 1 };
                    faces.entry(material(cell, normal)).or_default().push(quad);
                }
            }
        }
        for (material, quads) in faces {
            self.object(&format!("room_{material}"), material);
            for quad in quads {
                self.face(&quad);
            }
        }
    }

    /// An icosahedron, subdivided and projected.
    fn sphere(&mut self, centre: Point, radius: f64, subdivisions: u32) {
        // z of the rings of an icosahedron with a vertex at either pole.
        let (ring_z, ring_r) = (1.0 / 5.0_f64.sqrt(), 2.0 / 5.0_f64.sqrt());
        let ring = |k: usize, z: f64, turn: f64| {
            let angle = TAU * (k as f64 + turn) / 5.0;
            [ring_r * angle.cos(), ring_r * angle.sin(), z]
        };
        let (top, bottom) = ([0.0, 0.0, 1.0], [0.0, 0.0, -1.0]);
        let mut triangles: Vec<[Point; 3]> = Vec::new();
        for k in 0..5 {
            let (a, b) = (ring(k, ring_z, 0.0), ring(k + 1, ring_z, 0.0));
            let (c, d) = (ring(k, -ring_z, 0.5), ring(k + 1, -ring_z, 0.5));
            triangles.extend([[top, a, b], [a, c, b], [b, c, d], [bottom, d, c]]);
        }
        let middle = |a: Point, b: Point| {
            let sum = [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
            let length = sum.iter().map(|x| x * x).sum::<f64>().sqrt();
            sum.map(|x| x / length)
        };
        for _ in 0..subdivisions {
            triangles = (triangles.into_iter())
                .flat_map(|[a, b, c]| {
                    let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
                })
                .collect();
        }
        for t in triangles {
            self.face(&t.map(|p| [0, 1, 2].map(|i| centre[i] + radius * p[i])));
        }
    }

    /// A torus around a vertical axis.
    fn torus(&mut self, centre: Point, large: f64, small: f64, around: usize, across: usize) {
        let point = |i: usize, j: usize| {
            let (u, v) = (TAU * i as f64 / around as f64, TAU * j as f64 / across as f64);
            let r = large + small * v.cos();
            [centre[0] + r * u.cos(), centre[1] + r * u.sin(), centre[2] + small * v.sin()]
        };
        for i in 0..around {
            for j in 0..across {
                self.face(&[point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)]);
            }
        }
    }

    /// A box of half sizes `half`, tilted about y, then turned about z.
    fn plank(&mut self, centre: Point, half: Point, tilt: f64, turn: f64) {
        let place = |sx: f64, sy: f64, sz: f64| {
            let (x, y, z) = (sx * half[0], sy * half[1], sz * half[2]);
            let (x, z) = (x * tilt.cos() + z * tilt.sin(), z * tilt.cos() - x * tilt.sin());
            let (x, y) = (x * turn.cos() - y * turn.sin(), x * turn.sin() + y * turn.cos());
            [centre[0] + x, centre[1] + y, centre[2] + z]
        };
        let v: Vec<Point> = (0..8)
            .map(|i| {
                place(f64::from(i & 1) * 2.0 - 1.0, f64::from(i >> 1 & 1) * 2.0 - 1.0, f64::from(i >> 2) * 2.0 - 1.0)
            })
            .collect();
        for q in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
            self.face(&q.map(|i| v[i]));
        }
    }
}
