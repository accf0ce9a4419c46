//! Which vertices are at one place.

use glam::Vec3;

/// Side of the cells of [`nearby`], local units: 2^-20, about 1e-6 of the scene.
const CELL: f32 = 1.0 / 1_048_576.0;

/// For every position, the number of its place; equal coordinates are one place. Places are numbered in order of
/// coordinates, so that the numbering does not depend on the order of vertices.
pub(crate) fn exact(positions: &[Vec3]) -> Vec<u32> {
    by_key(positions, |p| (p + Vec3::ZERO).to_array().map(|x| x.to_bits() as i32))
}

/// As [`exact`], for positions rounded to a lattice: what differs by rounding of coordinates is one place.
pub(crate) fn nearby(positions: &[Vec3]) -> Vec<u32> {
    by_key(positions, |p| (p / CELL).round().to_array().map(|x| x as i32))
}

fn by_key(positions: &[Vec3], key: impl Fn(Vec3) -> [i32; 3]) -> Vec<u32> {
    let mut order: Vec<([i32; 3], u32)> = positions.iter().zip(0..).map(|(p, i)| (key(*p), i)).collect();
    order.sort_unstable();
    let mut place = vec![0; positions.len()];
    let mut n = 0;
    for i in 0..order.len() {
        if i > 0 && order[i].0 != order[i - 1].0 {
            n += 1;
        }
        place[order[i].1 as usize] = n;
    }
    place
}
