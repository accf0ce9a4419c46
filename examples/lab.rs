use glam::{DAffine3, DVec3};
use luxel::{
    BakeOptions, Relighter, bake,
    options::Resolution,
    progress::Silent,
    scene::{self, SceneOverrides},
};
use std::{f64::consts::TAU, path::Path, time::Instant};
const FRAMES: usize = 240;
fn place(frame: usize) -> DAffine3 {
    let turn = frame as f64 / FRAMES as f64 * TAU;
    let home = DVec3::new(278.0, 548.8, 279.5);
    let to = DVec3::new(278.0 + 130.0 * turn.cos(), 430.0 + 80.0 * (2.0 * turn).sin(), 279.5 + 130.0 * turn.sin());
    DAffine3::from_translation(to) * DAffine3::from_rotation_x(0.4 * turn.sin()) * DAffine3::from_translation(-home)
}
fn main() {
    let scene = scene::load(Path::new("scenes/cornell.toml"), &SceneOverrides::default()).unwrap().0;
    let options = BakeOptions { resolution: Resolution::Grid(64), estimate: false, ..BakeOptions::default() };
    let mut r = Relighter::new(scene.clone(), bake(&scene, &options, &Silent).unwrap()).unwrap();
    let (mut d, mut s, mut c, mut v) = (vec![], vec![], vec![], vec![]);
    let mut rays = 0;
    for k in 0..120 {
        r.place(0, place(k)).unwrap();
        let f = r.frame();
        rays = f.rays;
        d.push(f.seconds[0]);
        s.push(f.seconds[1]);
        c.push(f.seconds[2]);
        if k % 10 == 0 {
            let t = Instant::now();
            r.direct();
            v.push(t.elapsed().as_secs_f64());
        }
    }
    for (n, mut t) in [("direct", d), ("solve", s), ("carry", c), ("vertices", v)] {
        t.sort_by(f64::total_cmp);
        println!("{n}: min {:.2} median {:.2} ms", 1e3 * t[0], 1e3 * t[t.len() / 2]);
    }
    println!("rays {rays}");
}
