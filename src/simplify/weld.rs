//! Corners that are one vertex.

use std::collections::HashMap;

use glam::{IVec3, Vec3};
use rayon::prelude::*;

/// Positions nearer than this are equal; local units, a few ulp.
const WELD: f32 = 5e-7;
/// Corners are looked up in cells of this size, local units.
const CELL: f32 = 1e-4;
/// Corners in blocks of this size are welded apart from those in others.
const BLOCK: f32 = 0.02;
/// Moves the borders of the blocks away from round numbers, where walls stand.
const SHIFT: f32 = 0.007_639_32;
/// Corners nearer than this to the border of a block join it to the next: equal ones lie within [`WELD`] of each other,
/// and rounding adds less than that.
const MARGIN: f32 = 2.0 * WELD;
/// Parts of the work.
const SHARDS: u64 = 32;

/// Gives corners of equal position and normal the same number, in the order of their first; and how many there are.
/// `place` tells position and unit normal.
///
/// A corner is equal to the first one near it that is. Blocks of space are independent of each other but where a
/// corner lies on their border, which makes one of them: so the numbers are those of going through all in order.
pub fn weld<T: Sync>(corners: &[T], place: impl Fn(&T) -> (Vec3, Vec3) + Sync) -> (Vec<u32>, usize) {
    let shard_of = shards(corners, &place);
    let welded: Vec<Vec<(u32, u32)>> = (0..SHARDS as u8)
        .into_par_iter()
        .map(|shard| {
            let own = (0..).zip(&shard_of).filter(|s| *s.1 == shard).map(|s| s.0);
            weld_in_order(own, |i| place(&corners[i as usize]))
        })
        .collect();
    let mut shared = vec![0; corners.len()];
    welded.iter().flatten().for_each(|&(corner, first)| shared[corner as usize] = first);
    // The first of all has its number before any other asks for it.
    let mut count = 0;
    for i in 0..shared.len() {
        let first = shared[i] as usize;
        shared[i] = if first == i { count } else { shared[first] };
        count += (first == i) as u32;
    }
    (shared, count as usize)
}

/// Every corner of `own` and the first that is equal to it.
fn weld_in_order(own: impl Iterator<Item = u32>, place: impl Fn(u32) -> (Vec3, Vec3)) -> Vec<(u32, u32)> {
    let mut cells: HashMap<IVec3, Vec<u32>, BuildFast> = HashMap::default();
    own.map(|i| {
        let (position, normal) = place(i);
        let equal = |&r: &u32| {
            let other = place(r);
            (other.0 - position).abs().max_element() <= WELD && other.1.dot(normal) > 0.99999
        };
        // Equal positions may lie in neighbouring cells only within WELD of their border.
        if let Some(r) = around(position, CELL, WELD).filter_map(|c| cells.get(&c)).flatten().copied().find(equal) {
            return (i, r);
        }
        cells.entry(cell(position, CELL)).or_default().push(i);
        (i, i)
    })
    .collect()
}

/// The part of the work that each corner belongs to.
fn shards<T: Sync>(corners: &[T], place: &(impl Fn(&T) -> (Vec3, Vec3) + Sync)) -> Vec<u8> {
    let position = |corner: &T| place(corner).0 + SHIFT;
    let straddling: Vec<Vec3> =
        corners.par_iter().map(position).filter(|&p| around(p, BLOCK, MARGIN).nth(1).is_some()).collect();
    // Blocks that have a corner on their border, each with one that it is joined to.
    let mut joined: HashMap<IVec3, IVec3, BuildFast> = HashMap::default();
    for p in straddling {
        let first = root(&joined, cell(p, BLOCK));
        for other in around(p, BLOCK, MARGIN) {
            let other = root(&joined, other);
            if other != first {
                joined.insert(other, first);
            }
        }
    }
    let shard = |corner: &T| {
        let block = root(&joined, cell(position(corner), BLOCK));
        let mut hash = Fast::default();
        block.to_array().into_iter().for_each(|x| std::hash::Hasher::write_i32(&mut hash, x));
        (hash.0 % SHARDS) as u8
    };
    corners.par_iter().map(shard).collect()
}

fn root(joined: &HashMap<IVec3, IVec3, BuildFast>, mut block: IVec3) -> IVec3 {
    while let Some(&next) = joined.get(&block) {
        block = next;
    }
    block
}

fn cell(p: Vec3, size: f32) -> IVec3 {
    (p / size).floor().as_ivec3()
}

/// The cell of a position, away from where the voxels cut: equal positions have the same, all but always.
pub fn place(p: Vec3) -> [i32; 3] {
    cell(p + SHIFT, CELL).to_array()
}

/// The cells within `margin` of `p`.
fn around(p: Vec3, size: f32, margin: f32) -> impl Iterator<Item = IVec3> {
    let (low, high) = (cell(p - margin, size), cell(p + margin, size));
    (low.x..=high.x)
        .flat_map(move |x| (low.y..=high.y).flat_map(move |y| (low.z..=high.z).map(move |z| IVec3::new(x, y, z))))
}

/// A fast hash for small integer keys (multiply and fold).
#[derive(Clone, Copy, Default)]
pub struct Fast(u64);

pub type BuildFast = std::hash::BuildHasherDefault<Fast>;

impl std::hash::Hasher for Fast {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, bytes: &[u8]) {
        for &b in bytes {
            self.write_u64(b as u64);
        }
    }
    fn write_u32(&mut self, x: u32) {
        self.write_u64(x as u64);
    }
    fn write_i32(&mut self, x: i32) {
        self.write_u64(x as u32 as u64);
    }
    fn write_u64(&mut self, x: u64) {
        let product = ((self.0 ^ x) as u128).wrapping_mul(0x9e37_79b9_7f4a_7c15_f39c_c060_5ced_c835);
        self.0 = (product >> 64) as u64 ^ product as u64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::hash;

    #[test]
    fn corners_weld_as_if_they_came_one_by_one() {
        let mut k = 0;
        let mut random = || {
            k += 1;
            (hash(&[7, k]) >> 40) as f32 / (1u64 << 24) as f32
        };
        // Clumps about as wide as the welding distance, half of them on the borders of cells and blocks.
        let borders = [-SHIFT, BLOCK - SHIFT, 0.0, 13.0 * CELL];
        let clumps: Vec<Vec3> = (0..300)
            .map(|n| {
                Vec3::from_array([0; 3].map(|_| if n % 2 == 0 { borders[(random() * 4.0) as usize] } else { random() }))
            })
            .collect();
        let corners: Vec<(Vec3, Vec3)> = (0..20_000)
            .map(|_| {
                let clump = clumps[(random() * 300.0) as usize];
                let off = Vec3::from_array([0; 3].map(|_| (random() - 0.5) * 4.0 * WELD));
                (clump + off, if random() < 0.5 { Vec3::X } else { Vec3::Y })
            })
            .collect();
        let (shared, count) = weld(&corners, |&c| c);
        let mut numbers = HashMap::new();
        for (i, first) in weld_in_order(0..corners.len() as u32, |i| corners[i as usize]) {
            let next = numbers.len() as u32;
            assert_eq!(shared[i as usize], *numbers.entry(first).or_insert(next), "corner {i}");
        }
        assert_eq!(count, numbers.len());
        assert!(count > 300 && count < 15_000, "{count}");
    }
}
