//! Which sides of surfaces count.

use serde::{Deserialize, Serialize};

use super::Scene;

/// Which sides of surfaces count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SidesRule {
    /// Decided for every connected component.
    #[default]
    Auto,
    /// Fronts only, as wound.
    One,
    /// Both sides of everything.
    Two,
}

/// What was decided on one connected component, or on many of a kind.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SideDecision {
    /// Names of its meshes.
    pub meshes: Vec<String>,
    /// Triangles.
    pub triangles: usize,
}

/// Decides on the sides of all triangles of `scene`.
pub(crate) fn decide(scene: &mut Scene, rule: SidesRule) {
    for t in &mut scene.triangles {
        t.two_sided = rule != SidesRule::One;
    }
}
