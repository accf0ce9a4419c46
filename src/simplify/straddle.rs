//! The straddle split: points of one patch must see each other.
//!
//! A floor patch under a thin wall would carry light from one room to the next. Where points of a cluster do not see
//! each other, its fragments are cut by the planes of what stands between, and the pieces are grouped anew by mutual
//! visibility.

use std::cell::RefCell;

use glam::{Vec2, Vec3};

use super::{
    Fragments,
    clip::{depth_inside, point_at, uv_area, uv_centroid, uv_of},
    corners,
    surfels::UNLIKE,
};
use crate::trace::{Geometry, Hit, RayBatch, RayTracer};

/// A piece of a fragment's side.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    /// `fragment * 2 + side` before cutting.
    pub member: u32,
    /// Which piece of the fragment; 0 if it was not cut.
    pub piece: u32,
}

/// The groups of some voxels.
#[derive(Default)]
pub(super) struct Separated {
    /// Fragments that were cut, with their pieces.
    pub cuts: Vec<(u32, Vec<Vec<Vec2>>)>,
    /// Pieces of each patch, one patch after the other.
    pub pieces: Vec<Piece>,
    /// Where those of each patch end.
    pub ends: Vec<u32>,
}

const MOST_POINTS: usize = 12;
const MOST_PLANES: usize = 8;
const MOST_PIECES: usize = 32;

impl Separated {
    fn push(&mut self, group: impl IntoIterator<Item = Piece>) {
        self.pieces.extend(group);
        self.ends.push(self.pieces.len() as u32);
    }

    /// Pieces of each patch.
    pub fn groups(&self) -> impl Iterator<Item = &[Piece]> {
        let mut begin = 0;
        self.ends.iter().map(move |&end| &self.pieces[std::mem::replace(&mut begin, end as usize)..end as usize])
    }
}

/// Adds the clusters of one voxel to `out`, split where they straddle something.
pub(super) fn separate(
    geometry: &Geometry,
    normals: &[Vec3],
    fragments: &Fragments,
    clusters: Vec<Vec<u32>>,
    voxel_size: f32,
    tracer: &dyn RayTracer,
    out: &mut Separated,
) {
    let view = View { geometry, normals, fragments, lift: 0.02 * voxel_size, tracer };
    let mut cuts: Vec<(u32, Vec<Vec<Vec2>>)> = Vec::new();
    // Only unlike planes can stand between the points of a cluster.
    let normal = |m: u32| normals[fragments.triangle[(m >> 1) as usize] as usize];
    let first = normal(clusters[0][0]);
    let mut straddles = vec![false; clusters.len()];
    if clusters.iter().flatten().any(|&m| normal(m).dot(first).abs() < UNLIKE) {
        let all: Vec<Extent> = clusters.iter().flatten().map(|&m| view.extent(m)).collect();
        let mut extents = all.iter();
        for (cluster, straddles) in clusters.iter().zip(&mut straddles) {
            let blockers = view.blockers(cluster);
            // Fragments that end at the wall between them are not cut, but do not see each other either.
            *straddles = !blockers.is_empty();
            for own in extents.by_ref().take(cluster.len()) {
                let f = own.member >> 1;
                let planes = view.contacts(own, &all, &blockers);
                if planes.is_empty() {
                    continue;
                }
                let whole = || vec![fragments.uv(f as usize).to_vec()];
                let at = cuts.iter().position(|c| c.0 == f).unwrap_or_else(|| {
                    cuts.push((f, whole()));
                    cuts.len() - 1
                });
                cuts[at].1 = view.cut(f, std::mem::take(&mut cuts[at].1), &planes);
            }
        }
    }
    cuts.retain(|c| c.1.len() > 1);
    let pieces_of = |m: u32| cuts.iter().find(|c| c.0 == m >> 1).map_or(1, |c| c.1.len()) as u32;
    for (cluster, straddles) in clusters.iter().zip(straddles) {
        let pieces: Vec<Piece> =
            cluster.iter().flat_map(|&m| (0..pieces_of(m)).map(move |piece| Piece { member: m, piece })).collect();
        let was_cut = pieces.len() > cluster.len();
        if (was_cut || straddles) && pieces.len() <= MOST_PIECES {
            view.cliques(&cuts, &pieces).into_iter().for_each(|clique| out.push(clique));
        } else {
            out.push(pieces);
        }
    }
    out.cuts.extend(cuts);
}

/// Where a side of a fragment lies.
struct Extent {
    member: u32,
    normal: Vec3,
    low: Vec3,
    high: Vec3,
}

impl Extent {
    /// Whether the boxes of both are nearer to each other than `distance`.
    fn is_near(&self, other: &Extent, distance: f32) -> bool {
        ((self.low - distance).cmple(other.high) & (other.low - distance).cmple(self.high)).all()
    }
}

struct View<'a> {
    geometry: &'a Geometry,
    normals: &'a [Vec3],
    fragments: &'a Fragments,
    /// How far points stand off the surface.
    lift: f32,
    tracer: &'a dyn RayTracer,
}

thread_local! {
    static SCRATCH: RefCell<(RayBatch, Vec<Hit>)> = RefCell::default();
}

impl View<'_> {
    fn normal(&self, member: u32) -> Vec3 {
        let n = self.normals[self.fragments.triangle[(member >> 1) as usize] as usize];
        if member & 1 == 1 { -n } else { n }
    }

    fn extent(&self, member: u32) -> Extent {
        let f = (member >> 1) as usize;
        let own = corners(self.geometry, self.fragments.triangle[f] as usize);
        let points = self.fragments.uv(f).iter().map(|&uv| point_at(&own, uv));
        let start = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let (low, high) = points.fold(start, |(low, high), p| (low.min(p), high.max(p)));
        Extent { member, normal: self.normal(member), low, high }
    }

    fn lifted(&self, member: u32, uv: Vec2) -> Vec3 {
        let t = self.fragments.triangle[(member >> 1) as usize] as usize;
        point_at(&corners(self.geometry, t), uv) + self.lift * self.normal(member)
    }

    /// What triangle stands between the points; like normals do not count, or convex surfaces would block themselves.
    fn between(&self, pairs: &[(Vec3, Vec3)], normal: Vec3, mut tell: impl FnMut(usize, Option<usize>)) {
        SCRATCH.with_borrow_mut(|(rays, hits)| {
            rays.clear();
            for (p, q) in pairs {
                rays.push(*p, *q - *p, 0.0, 1.0);
            }
            hits.clear();
            hits.resize(rays.len(), Hit::NONE);
            self.tracer.closest_hits(rays, hits);
            for (i, hit) in hits.iter().enumerate() {
                let blocks = hit.is_hit() && self.normals[hit.triangle()].dot(normal).abs() < UNLIKE;
                tell(i, blocks.then(|| hit.triangle()));
            }
        });
    }

    /// Triangles that stand between points of the cluster.
    fn blockers(&self, cluster: &[u32]) -> Vec<u32> {
        let mut points: Vec<Vec3> = Vec::new();
        for &m in cluster {
            let uv = self.fragments.uv((m >> 1) as usize);
            let middle = uv_centroid(uv);
            points.push(self.lifted(m, middle));
            points.extend(uv.iter().map(|p| self.lifted(m, p.lerp(middle, 0.15))));
        }
        if points.len() > MOST_POINTS {
            let all = points.len();
            points = (0..MOST_POINTS).map(|k| points[k * all / MOST_POINTS]).collect();
        }
        let pairs: Vec<(Vec3, Vec3)> = (0..points.len())
            .flat_map(|i| (0..points.len()).filter(move |&j| j != i).map(move |j| (i, j)))
            .map(|(i, j)| (points[i], points[j]))
            .collect();
        let mut found: Vec<u32> = Vec::new();
        self.between(&pairs, self.normal(cluster[0]), |_, blocker| {
            if let Some(t) = blocker.map(|t| t as u32)
                && found.len() < MOST_PLANES
                && !found.iter().any(|&other| self.same_plane(other, t))
            {
                found.push(t);
            }
        });
        found
    }

    /// `blockers`, and the triangles that stand on the side `own`: whose fragments in this voxel meet it.
    fn contacts(&self, own: &Extent, all: &[Extent], blockers: &[u32]) -> Vec<u32> {
        let mut planes = blockers.to_vec();
        let f = (own.member >> 1) as usize;
        let (corners_of_own, uv) = (corners(self.geometry, self.fragments.triangle[f] as usize), self.fragments.uv(f));
        // Where another fragment passes through a plane slightly above the side: its height over that plane.
        let height = |p: Vec3| (p - corners_of_own[0]).dot(own.normal) - 0.5 * self.lift;
        let edge = 1e-3 * uv_area(uv).max(0.0).sqrt() as f32;
        // Most of a voxel full of foliage is too far away to meet the side.
        for other in all.iter().filter(|other| other.is_near(own, self.lift)) {
            let t = self.fragments.triangle[(other.member >> 1) as usize];
            if other.normal.dot(own.normal).abs() >= UNLIKE
                || planes.len() == MOST_PLANES
                || planes.iter().any(|&p| self.same_plane(p, t))
            {
                continue;
            }
            let theirs = corners(self.geometry, t as usize);
            let points = self.fragments.uv((other.member >> 1) as usize).iter().map(|&uv| point_at(&theirs, uv));
            let mut crossings = points
                .clone()
                .zip(points.cycle().skip(1))
                .map(|(a, b)| ((a, height(a)), (b, height(b))))
                .filter(|(a, b)| a.1 * b.1 < 0.0)
                .map(|(a, b)| a.0.lerp(b.0, a.1 / (a.1 - b.1)));
            if let (Some(a), Some(b)) = (crossings.next(), crossings.next())
                && [0.25, 0.5, 0.75].iter().any(|&s| depth_inside(uv, uv_of(&corners_of_own, a.lerp(b, s))) > edge)
            {
                planes.push(t);
            }
        }
        planes
    }

    fn same_plane(&self, a: u32, b: u32) -> bool {
        let (na, nb) = (self.normals[a as usize], self.normals[b as usize]);
        let apart = (corners(self.geometry, a as usize)[0] - corners(self.geometry, b as usize)[0]).dot(na);
        na.dot(nb).abs() > 0.9999 && apart.abs() < 1e-3 * self.lift
    }

    /// Cuts the pieces of fragment `f` by the planes of triangles.
    fn cut(&self, f: u32, mut pieces: Vec<Vec<Vec2>>, planes: &[u32]) -> Vec<Vec<Vec2>> {
        let own = corners(self.geometry, self.fragments.triangle[f as usize] as usize);
        let dust = 1e-5 * uv_area(self.fragments.uv(f as usize));
        for &plane in planes {
            let at = corners(self.geometry, plane as usize)[0];
            let n = self.normals[plane as usize];
            let height = |uv: Vec2| (point_at(&own, uv) - at).dot(n);
            pieces = pieces
                .into_iter()
                .flat_map(|piece| {
                    let (below, above) = cut_polygon(&piece, height);
                    let solid = |p: &Vec<Vec2>| p.len() >= 3 && uv_area(p) > dust;
                    if solid(&below) && solid(&above) { vec![below, above] } else { vec![piece] }
                })
                .collect();
        }
        pieces
    }

    /// Groups pieces so that all of a group see each other; the largest first.
    fn cliques(&self, cuts: &[(u32, Vec<Vec<Vec2>>)], pieces: &[Piece]) -> Vec<Vec<Piece>> {
        let polygon = |p: &Piece| -> &[Vec2] {
            cuts.iter()
                .find(|c| c.0 == p.member >> 1)
                .map_or_else(|| self.fragments.uv((p.member >> 1) as usize), |c| &c.1[p.piece as usize])
        };
        let area = |p: &Piece| {
            let [a, b, c] = corners(self.geometry, self.fragments.triangle[(p.member >> 1) as usize] as usize);
            (b - a).cross(c - a).length() as f64 * uv_area(polygon(p))
        };
        let n = pieces.len();
        let points: Vec<Vec3> = pieces.iter().map(|p| self.lifted(p.member, uv_centroid(polygon(p)))).collect();
        let index: Vec<(usize, usize)> = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))).collect();
        let pairs: Vec<(Vec3, Vec3)> = index.iter().map(|&(i, j)| (points[i], points[j])).collect();
        let mut visible = vec![true; n * n];
        self.between(&pairs, self.normal(pieces[0].member), |k, blocker| {
            let (i, j) = index[k];
            visible[i * n + j] = blocker.is_none();
            visible[j * n + i] = blocker.is_none();
        });
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|&i, &j| area(&pieces[j]).total_cmp(&area(&pieces[i])).then(i.cmp(&j)));
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for i in order {
            match groups.iter_mut().find(|g| g.iter().all(|&j| visible[i * n + j])) {
                Some(group) => group.push(i),
                None => groups.push(vec![i]),
            }
        }
        groups.into_iter().map(|g| g.into_iter().map(|i| pieces[i]).collect()).collect()
    }
}

/// Both halves of a convex polygon at the zero line of a linear function.
fn cut_polygon(polygon: &[Vec2], height: impl Fn(Vec2) -> f32) -> (Vec<Vec2>, Vec<Vec2>) {
    let (mut below, mut above) = (Vec::new(), Vec::new());
    for (i, &a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let (ha, hb) = (height(a), height(b));
        if ha <= 0.0 {
            below.push(a);
        }
        if ha >= 0.0 {
            above.push(a);
        }
        if ha * hb < 0.0 {
            let corner = a.lerp(b, ha / (ha - hb));
            below.push(corner);
            above.push(corner);
        }
    }
    (below, above)
}
