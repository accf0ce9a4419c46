//! Polygons to triangles.

use glam::{DVec2, DVec3};

/// Cuts a polygon into triangles of corner numbers, wound as the polygon is.
///
/// Repeated corners are left out, so that a polygon that walks its border several times counts once. Convex polygons
/// become fans, others are cut by ear clipping in the plane of the Newell normal; a polygon without an area gives
/// nothing. Corners must be finite.
pub(crate) fn triangulate(corners: &[DVec3]) -> Vec<[u32; 3]> {
    let mut ring: Vec<u32> = Vec::with_capacity(corners.len());
    if corners.len() <= 4 {
        ring.extend((0..corners.len() as u32).filter(|&i| !corners[..i as usize].contains(&corners[i as usize])));
    } else {
        let mut seen = std::collections::HashSet::with_capacity(corners.len());
        ring.extend((0..corners.len() as u32).filter(|&i| {
            let p = corners[i as usize] + 0.0; // -0 and 0 are one place
            seen.insert(p.to_array().map(f64::to_bits))
        }));
    }
    match ring.len() {
        0..=2 => return Vec::new(),
        3 => return vec![[ring[0], ring[1], ring[2]]],
        _ => {}
    }
    // Relative to the first corner, so that polygons far from the origin keep their digits.
    let points: Vec<DVec3> = ring.iter().map(|&i| corners[i as usize] - corners[ring[0] as usize]).collect();
    let Some(flat) = project(&points) else { return Vec::new() };
    if is_convex(&flat) {
        return (1..ring.len() - 1).map(|i| [ring[0], ring[i], ring[i + 1]]).collect();
    }
    let mut out: Vec<u32> = Vec::new();
    earcut::Earcut::new().earcut(flat.iter().map(|p| [p.x, p.y]), &[], &mut out);
    out.chunks_exact(3)
        .map(|t| {
            let [a, b, c] = [t[0], t[1], t[2]].map(|i| flat[i as usize]);
            // Ear clipping may return either orientation; `project` makes the polygon's own positive.
            let t = if (b - a).perp_dot(c - a) < 0.0 { [t[0], t[2], t[1]] } else { [t[0], t[1], t[2]] };
            t.map(|i| ring[i as usize])
        })
        .collect()
}

/// Coordinates in the plane of the Newell normal, counter-clockwise seen from the normal's tip; `None` without area.
fn project(points: &[DVec3]) -> Option<Vec<DVec2>> {
    let size = points.iter().fold(0.0, |m: f64, p| m.max(p.abs().max_element()));
    if size == 0.0 {
        return None;
    }
    let points: Vec<DVec3> = points.iter().map(|p| *p / size).collect();
    let normal: DVec3 = (0..points.len()).map(|i| points[i].cross(points[(i + 1) % points.len()])).sum();
    if normal.length() < 1e-14 {
        return None;
    }
    let (u, v) = normal.normalize().any_orthonormal_pair();
    let sign = u.cross(v).dot(normal).signum();
    Some(points.iter().map(|p| DVec2::new(p.dot(u), sign * p.dot(v))).collect())
}

/// Whether a counter-clockwise polygon turns left everywhere and only once around.
fn is_convex(points: &[DVec2]) -> bool {
    let n = points.len();
    let edge = |i: usize| points[(i + 1) % n] - points[i % n];
    let turn: f64 = (0..n).map(|i| edge(i).angle_to(edge(i + 1))).sum();
    (0..n).all(|i| edge(i).perp_dot(edge(i + 1)) >= 0.0) && turn < 1.5 * std::f64::consts::TAU
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(corners: &[DVec3]) -> f64 {
        let tri = triangulate(corners);
        tri.iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| corners[i as usize]);
                0.5 * (b - a).cross(c - a).length()
            })
            .sum()
    }

    fn points(list: &[[f64; 2]]) -> Vec<DVec3> {
        list.iter().map(|p| DVec3::new(p[0], 3.0, p[1])).collect()
    }

    #[test]
    fn a_concave_polygon_keeps_its_area_and_winding() {
        let l = points(&[[0., 0.], [2., 0.], [2., 1.], [1., 1.], [1., 3.], [0., 3.]]);
        assert!((area(&l) - 4.0).abs() < 1e-12);
        for t in triangulate(&l) {
            let [a, b, c] = t.map(|i| l[i as usize]);
            assert!((b - a).cross(c - a).y < 0.0);
        }
        let mut reversed = l.clone();
        reversed.reverse();
        for t in triangulate(&reversed) {
            let [a, b, c] = t.map(|i| reversed[i as usize]);
            assert!((b - a).cross(c - a).y > 0.0);
        }
    }

    #[test]
    fn a_polygon_that_walks_its_border_twice_counts_once() {
        let square = [[0., 0.], [1., 0.], [1., 1.], [0., 1.]];
        assert!((area(&points(&[square, square].concat())) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_polygon_far_from_the_origin_keeps_its_area() {
        let l: Vec<DVec3> = points(&[[0., 0.], [2., 0.], [2., 1.], [1., 1.], [1., 3.], [0., 3.]])
            .iter()
            .map(|p| *p + DVec3::splat(1e7))
            .collect();
        assert!((area(&l) - 4.0).abs() < 1e-7, "coordinates of 1e7 are exact to 2e-9");
    }

    #[test]
    fn polygons_without_area_give_nothing() {
        assert!(triangulate(&points(&[[0., 0.], [1., 1.], [2., 2.], [3., 3.]])).is_empty());
        assert!(triangulate(&points(&[[0., 0.], [0., 0.], [1., 1.], [1., 1.]])).is_empty());
        assert!(triangulate(&[]).is_empty());
    }
}
