//! Which patches points take their light from, found out once.

use std::{collections::HashMap, sync::OnceLock};

use rayon::prelude::*;

use super::{CHUNK, Field, smooth};
use crate::scene::SurfacePoint;

/// A patch near a point.
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Neighbour {
    /// The patch.
    pub patch: u32,
    /// Its weight in the fit; positive.
    pub weight: f32,
}

/// For some points, the patches that they see on their own surface, with their weights in the fit of
/// [`Reconstruct::Smooth`](crate::options::Reconstruct::Smooth). They depend on which patches are known, but not on
/// light.
#[derive(Clone, Debug, Default)]
pub struct Stencils {
    points: Vec<SurfacePoint>,
    /// Where the neighbours of each point end.
    ends: Vec<u32>,
    neighbours: Vec<Neighbour>,
    /// The number of each point by its bits, once somebody asks: who writes stencils to a file does not.
    numbers: OnceLock<HashMap<[u32; 6], u32>>,
}

impl Stencils {
    /// Successive points that are asked together: the stencils of a list are those of its parts, if all parts but the last hold
    /// a multiple of so many.
    pub const TOGETHER: usize = CHUNK;

    /// Finds the neighbours of `points`; the values of `field` do not matter.
    pub fn new(field: &Field, points: &[SurfacePoint]) -> Stencils {
        let found: Vec<(Vec<u32>, Vec<Neighbour>)> =
            points.par_chunks(CHUNK).map(|chunk| smooth::neighbours(field, chunk)).collect();
        let (mut ends, mut neighbours) = (Vec::with_capacity(points.len()), Vec::new());
        for (own_ends, own) in found {
            let mut begin = 0;
            for end in own_ends {
                neighbours.extend(own[begin as usize..end as usize].iter().filter(|n| n.weight > 0.0));
                ends.push(neighbours.len() as u32);
                begin = end;
            }
        }
        Stencils::of(points.to_vec(), ends, neighbours)
    }

    /// Stencils of these parts, of which those of point k end at `ends[k]`.
    pub fn of(points: Vec<SurfacePoint>, ends: Vec<u32>, neighbours: Vec<Neighbour>) -> Stencils {
        Stencils { points, ends, neighbours, numbers: OnceLock::new() }
    }

    /// The stencils of all parts together, in their order.
    pub fn joined(parts: Vec<Stencils>) -> Stencils {
        let sum = |length: fn(&Stencils) -> usize| parts.iter().map(length).sum::<usize>();
        let (points, neighbours) = (sum(|part| part.points.len()), sum(|part| part.neighbours.len()));
        let mut all = Stencils::with_room(points, neighbours);
        parts.into_iter().for_each(|part| all.append(part));
        all
    }

    /// None yet, with room for those of so many points: what nobody writes of it takes no memory.
    pub fn with_room_for(points: usize) -> Stencils {
        Stencils::with_room(points, points * smooth::MOST)
    }

    fn with_room(points: usize, neighbours: usize) -> Stencils {
        let ends = Vec::with_capacity(points);
        Stencils::of(Vec::with_capacity(points), ends, Vec::with_capacity(neighbours))
    }

    /// Adds the stencils of further points.
    pub fn append(&mut self, part: Stencils) {
        let first = self.neighbours.len() as u32;
        self.points.extend(part.points);
        self.ends.extend(part.ends.iter().map(|end| first + end));
        self.neighbours.extend(part.neighbours);
        self.numbers = OnceLock::new();
    }

    /// The points, where the neighbours of each end, and all neighbours.
    pub fn parts(&self) -> (&[SurfacePoint], &[u32], &[Neighbour]) {
        (&self.points, &self.ends, &self.neighbours)
    }

    /// The neighbours of a point; `None` if it is none of those.
    pub fn find(&self, point: &SurfacePoint) -> Option<&[Neighbour]> {
        let numbers = || (0..).zip(&self.points).map(|(k, point)| (key(point), k)).collect();
        let k = *self.numbers.get_or_init(numbers).get(&key(point))? as usize;
        let begin = if k == 0 { 0 } else { self.ends[k - 1] };
        Some(&self.neighbours[begin as usize..self.ends[k] as usize])
    }
}

fn key(point: &SurfacePoint) -> [u32; 6] {
    let [p, n] = [point.position, point.normal].map(|v| v.to_array().map(f32::to_bits));
    [p[0], p[1], p[2], n[0], n[1], n[2]]
}
