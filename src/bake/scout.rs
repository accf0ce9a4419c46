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

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::{
        options::{Backend, Resolution},
        progress::Silent,
        scene::SidesRule,
        selftest::world::World,
        simplify::{self, Grid},
        trace,
        transfer::{self, RowPoints},
    };

    /// A winding passage of so many bends, a room that nothing leads to, and a block in the first leg that hides a piece of its
    /// floor. Light starts in the first leg.
    #[test]
    fn light_is_found_round_many_bends_and_not_in_a_sealed_room() {
        const LEGS: usize = 12;
        let mut world = World::new();
        let grey = world.grey(0.5, 0.0);
        let (width, length) = (1.0, LEGS as f64);
        world.room(DVec3::ZERO, DVec3::new(length, 1.0, 4.0), grey);
        world.room(DVec3::new(0.0, 2.0, 0.0), DVec3::new(length, 3.0, 4.0), grey);
        world.block(DVec3::new(0.3, 0.0, 1.3), DVec3::new(0.7, 0.5, 1.7), grey);
        for wall in 1..LEGS {
            let x = wall as f64 * width;
            let low = if wall % 2 == 0 { 0.5 } else { 0.0 };
            world.block(DVec3::new(x - 0.05, 0.0, low), DVec3::new(x + 0.05, 1.0, low + 3.5), grey);
        }
        let scene = world.builder.build(SidesRule::One).unwrap();
        let grid = Grid::new(&scene, Resolution::Grid(48)).unwrap();
        let tracer = trace::build(Backend::Auto, &scene.geometry()).unwrap();
        let simplified = simplify::surfels(&scene, grid, &*tracer);
        let centroid = |i: usize| scene.frame.to_world(simplified.patches.centroid[i]);
        let n = simplified.patches.len();
        let lit: Vec<bool> = (0..n).map(|i| centroid(i).x < 0.9 && centroid(i).y < 1.5).collect();
        let points = RowPoints::new(256, 3, &*tracer);
        let casting = Casting::new(&simplified, &*tracer, &[], &points);

        let found = reached(&casting, &lit, &Silent).unwrap();
        let bake = transfer::estimate(&simplified, &*tracer, &lit, false, 256, 3, &Silent).unwrap();
        let truth: Vec<bool> = (0..n).map(|i| bake.reached[i] && bake.visible[i]).collect();
        // Round all bends, and not into the sealed room.
        let count = |which: &dyn Fn(usize) -> bool| (0..n).filter(|&i| which(i)).count();
        let end = |i: usize| centroid(i).x > length - 0.9 && centroid(i).y < 1.5;
        assert!(count(&|i| found[i] && end(i)) > 20, "{} at the end", count(&|i| found[i] && end(i)));
        assert_eq!(count(&|i| found[i] && centroid(i).y > 1.5), 0);
        // Patches whose view of others is next to nothing are of either kind, by chance: they lie at edges that touch.
        let other = count(&|i| found[i] != truth[i]);
        assert!(other * 50 < count(&|i| truth[i]), "{other} of {} reached of {n}", count(&|i| truth[i]));
    }

    #[test]
    fn a_ray_in_a_million_slips_through_and_lets_no_light_in() {
        let mut sets = Sets::new(6);
        for (a, b) in [(4, 2), (2, 3), (5, 1)] {
            sets.join(a, b);
        }
        (2..5).for_each(|i| sets.add_rays(i, 1_000_000));
        sets.add_finds(3, 3);
        sets.add_rays(1, 16);
        sets.add_finds(5, 1);
        let lit: Vec<bool> = (0..6).map(|i| sets.is_lit(i)).collect();
        assert_eq!(lit, [false, true, false, false, false, true]);
        // Joined later, they are one.
        sets.join(0, 5);
        assert!(sets.is_lit(0) && sets.is_lit(1));
    }
}
