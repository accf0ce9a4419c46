//! Which patches light will reach, before their rows are cast.

use crate::{
    Result,
    progress::{Hushed, Progress},
    transfer::{self, Casting, RowPoints, Rows},
};

/// Rays of a patch: neighbours find light together, so few do.
const RAYS: u32 = 16;
/// Patches whose rays are in memory at one time.
const AT_ONCE: usize = 1 << 14;
/// Rays slip through the edge between two triangles about once in a million. Where not more than this share finds light, none
/// gets in.
const SLIPPED: f64 = 2e-5;

/// Which patches are neither hidden inside objects nor dark, if rows start at those of `start`: these, and those from which
/// a chain of patches, each seen by the last one or the last one by it, leads to them.
///
/// The bake learns that from its rows. Here every patch that does not belong to `start` casts a few rays, and who sees each
/// other is together in light or in the dark.
///
/// # Errors
/// [`Error::Interrupted`](crate::Error::Interrupted).
pub(super) fn reached(casting: &Casting, start: &[bool], progress: &dyn Progress) -> Result<Vec<bool>> {
    let points = RowPoints::new(casting.points.rays().min(RAYS), casting.points.seed(), casting.tracer);
    let casting = Casting { points: &points, marked: false, ..*casting };
    let mut reached = transfer::foresee_visible(&casting);
    let others: Vec<u32> = (0..start.len()).filter(|&i| reached[i] && !start[i]).map(|i| i as u32).collect();
    let mut sets = Sets::new(start.len());
    for some in others.chunks(AT_ONCE) {
        let mut rows = Rows::new(start.len());
        transfer::cast(&casting, some, &[], &mut rows, &mut (), &Hushed(progress))?;
        for row in some.iter().filter_map(|&i| rows.get(i)) {
            sets.add_rays(row.row.patch, row.row.valid);
            row.entries().for_each(|(j, hits)| match start[j as usize] {
                true => sets.add_finds(row.row.patch, hits),
                false => sets.join(row.row.patch, j),
            });
        }
    }
    others.iter().for_each(|&i| reached[i as usize] = sets.is_lit(i));
    Ok(reached)
}

/// Patches in sets of those that see each other.
struct Sets {
    /// Another patch of the set, or itself.
    parent: Vec<u32>,
    /// Where a patch is its own parent: rays of its set, and those that found light.
    rays: Vec<[u32; 2]>,
}

impl Sets {
    fn new(patches: usize) -> Sets {
        Sets { parent: (0..patches as u32).collect(), rays: vec![[0; 2]; patches] }
    }

    fn root(&mut self, mut i: u32) -> u32 {
        while self.parent[i as usize] != i {
            // Half as long a way for who comes next.
            let next = self.parent[i as usize];
            self.parent[i as usize] = self.parent[next as usize];
            i = next;
        }
        i
    }

    fn add_rays(&mut self, i: u32, rays: u32) {
        let root = self.root(i);
        let all = &mut self.rays[root as usize][0];
        *all = all.saturating_add(rays);
    }

    fn add_finds(&mut self, i: u32, hits: u32) {
        let root = self.root(i);
        let all = &mut self.rays[root as usize][1];
        *all = all.saturating_add(hits);
    }

    fn join(&mut self, i: u32, j: u32) {
        let (i, j) = (self.root(i), self.root(j));
        let (low, high) = (i.min(j), i.max(j));
        if low != high {
            let [rays, finds] = std::mem::take(&mut self.rays[high as usize]);
            self.parent[high as usize] = low;
            let all = &mut self.rays[low as usize];
            *all = [all[0].saturating_add(rays), all[1].saturating_add(finds)];
        }
    }

    fn is_lit(&mut self, i: u32) -> bool {
        let root = self.root(i);
        let [rays, finds] = self.rays[root as usize];
        finds as f64 > SLIPPED * rays as f64
    }
}
