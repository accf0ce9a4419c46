//! Rows of form factors between rectangles, against Howell's catalogue.

use super::{
    Row, World,
    closed_forms::{PARALLEL, PERPENDICULAR, parallel, perpendicular},
    options, rows,
};
use crate::{
    BakeOptions, Result,
    options::{Backend, Primary},
};

/// Corner and edges of a rectangle; its front is on the side of the edges' cross product.
type Rectangle = [[f64; 3]; 3];

/// Both rectangles of `[a, b, c]`, see [`parallel`].
pub fn parallel_rectangles([a, b, c]: [f64; 3]) -> [Rectangle; 2] {
    [[[0.0; 3], [a, 0.0, 0.0], [0.0, b, 0.0]], [[0.0, 0.0, c], [0.0, b, 0.0], [a, 0.0, 0.0]]]
}

/// Both rectangles of `[h, w, l]`, see [`perpendicular`]: the one that lies, the one that stands.
pub fn perpendicular_rectangles([h, w, l]: [f64; 3]) -> [Rectangle; 2] {
    [[[0.0; 3], [w, 0.0, 0.0], [0.0, l, 0.0]], [[0.0; 3], [0.0, l, 0.0], [0.0, 0.0, h]]]
}

/// The catalogue's rectangles, both ways.
pub(super) fn catalogue(backend: Backend) -> Result<Vec<Row>> {
    let mut table = Vec::new();
    for (abc @ [a, b, c], _) in PARALLEL {
        let expected = parallel(abc);
        let case = format!("form factor, parallel {a} x {b} at {c}");
        table.push(exchange(&case, parallel_rectangles(abc), [expected; 2], backend)?);
    }
    for (hwl @ [h, w, l], _) in PERPENDICULAR {
        let expected = perpendicular(hwl);
        let case = format!("form factor, upright {w} and {h} on {l}");
        // Reciprocity: areas times form factors are equal.
        table.push(exchange(&case, perpendicular_rectangles(hwl), [expected, expected * w / h], backend)?);
    }
    Ok(table)
}

/// The form factor from the first to the second rectangle or that back, whichever is further off.
fn exchange(case: &str, rectangles: [Rectangle; 2], expected: [f64; 2], backend: Backend) -> Result<Row> {
    let mut world = World::new();
    // Both emit, so that both have rows.
    let material = world.grey(0.5, 1.0);
    for (name, [corner, u, v]) in ["one", "two"].into_iter().zip(rectangles) {
        world.quad(name, corner.into(), u.into(), v.into(), material);
    }
    let scene = world.build()?.0;
    let options = BakeOptions { primary: Primary::Radiosity, ..options(12, 1024, backend) };
    let bake = crate::bake(&scene, &options, &crate::progress::Silent)?;
    let one: Vec<bool> = (0..bake.patches().len()).map(|i| rows::mesh_of(&scene, &bake, i) == "one").collect();
    let between = |to_one: bool| {
        rows::between(bake.patches(), &bake.form_factors, &options, |i| one[i] != to_one, |j| one[j] == to_one)
    };
    let ((there, sigma), (back, sigma_back)) = (between(false), between(true));
    let there = Row::sigmas(case, there, expected[0], sigma);
    let back = Row::sigmas(format!("{case}, back"), back, expected[1], sigma_back);
    Ok(there.or_worse(back))
}
