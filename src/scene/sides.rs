//! Which sides of surfaces count.
//!
//! The rule of [`SidesRule::Auto`], by connected component (see `topology.rs`):
//! - Winding that differs within a component is repaired; where no common winding exists (a Moebius strip), the component
//!   is two-sided as it stands.
//! - A closed surface is a solid: one-sided, normals outwards.
//! - Unless it holds a light: then it is a room, normals inwards. Of closed surfaces around one light the innermost is a
//!   room, the next the outside of its walls, and so on. A closed surface that glows itself is a lamp, unless nothing
//!   lies outside it, or it is wound inwards and holds something: then it is a room too.
//! - Everything else is a sheet: two-sided. It emits from its front; from both sides if its material is double-sided.
//!   A glowing sheet whose front is shut off or sees nothing at all, while its back is free, is turned around.
//! - A double-sided material makes rooms two-sided; the inside of a solid stays hidden.

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::{
    Light, Scene,
    builder::list,
    facing,
    shell::Shell,
    topology::{self, Components},
};

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

/// What a connected component was taken for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SideKind {
    /// Closed, seen from outside.
    Solid,
    /// Closed, seen from inside.
    Room,
    /// Open, seen from both sides.
    Sheet,
    /// Without a common winding, seen from both sides.
    NotOrientable,
    /// As `--sides one|two` says.
    Forced,
}

/// What was decided on one connected component, or on several of one kind.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SideDecision {
    /// How many components this is about.
    pub components: usize,
    /// Names of their meshes, at most four.
    pub meshes: Vec<String>,
    /// Triangles of all of them.
    pub triangles: usize,
    /// What they were taken for.
    pub kind: SideKind,
    /// Triangles that were turned around.
    pub turned: usize,
}

impl std::fmt::Display for SideDecision {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let kind = match self.kind {
            SideKind::Solid => "closed, seen from outside",
            SideKind::Room => "closed, seen from inside",
            SideKind::Sheet => "open, seen from both sides",
            SideKind::NotOrientable => "without a common winding, seen from both sides",
            SideKind::Forced => "as asked for",
        };
        write!(f, "{}: {} triangles, {kind}", self.meshes.join(", "), self.triangles)?;
        if self.components > 1 {
            write!(f, ", {} components", self.components)?;
        }
        if self.turned > 0 {
            write!(f, ", {} turned around", self.turned)?;
        }
        Ok(())
    }
}

/// Decisions that stand alone; further components are summed by kind.
const MOST_DECISIONS: usize = 24;

/// Lights that are looked for inside shells, and glowing sheets whose front is probed: the largest ones.
const MOST_LIGHTS: usize = 256;

/// How far in front of a glowing surface its light is thought to be, local units.
const IN_FRONT: f64 = 1e-4;

/// Decides on the sides of all triangles of `scene` and turns them accordingly.
pub(crate) fn decide(scene: &mut Scene, rule: SidesRule) {
    let double: Vec<bool> = scene.triangles.iter().map(|t| scene.materials[t.material as usize].double_sided).collect();
    if rule != SidesRule::Auto {
        for (t, double) in scene.triangles.iter_mut().zip(double) {
            t.two_sided = rule == SidesRule::Two;
            t.emits_back = t.two_sided && double;
        }
        scene.sides = vec![SideDecision {
            components: 1,
            meshes: scene.meshes.iter().take(4).cloned().collect(),
            triangles: scene.triangles.len(),
            kind: SideKind::Forced,
            turned: 0,
        }];
        return;
    }
    let components = topology::components(&scene.positions, &scene.triangles);
    let mut decided = Decided::new(scene, &components);
    decided.turn_shut_lamps(scene);
    decided.find_rooms(scene);
    decided.record(scene);
    for (t, triangle) in scene.triangles.iter_mut().enumerate() {
        let kind = decided.kind[components.of[t] as usize];
        triangle.two_sided = match kind {
            SideKind::Solid => false,
            SideKind::Room => double[t],
            _ => true,
        };
        triangle.emits_back = triangle.two_sided && double[t];
    }
}

struct Decided<'a> {
    components: &'a Components,
    kind: Vec<SideKind>,
    /// Closed surfaces, as wound in the scene by now.
    shells: Vec<Option<Shell>>,
    /// Whether the file wound it inwards.
    inward: Vec<bool>,
    /// Whether each triangle is turned by now.
    turned: Vec<bool>,
    /// Glowing triangle of the largest area and power of every component.
    glow: Vec<Option<u32>>,
    shut: Vec<String>,
}

impl<'a> Decided<'a> {
    /// Repairs windings and turns all closed surfaces outwards.
    fn new(scene: &mut Scene, components: &'a Components) -> Decided<'a> {
        let n = components.list.len();
        let mut decided = Decided {
            components,
            kind: vec![SideKind::Sheet; n],
            shells: (0..n).map(|_| None).collect(),
            inward: vec![false; n],
            turned: vec![false; scene.triangles.len()],
            glow: vec![None; n],
            shut: Vec::new(),
        };
        for (c, component) in components.list.iter().enumerate() {
            for &t in component.triangles.iter().filter(|&&t| components.turn[t as usize]) {
                decided.turn(scene, t);
            }
            if !component.orientable {
                decided.kind[c] = SideKind::NotOrientable;
            } else if component.closed {
                decided.kind[c] = SideKind::Solid;
                let shell = Shell::new(component.triangles.iter().map(|&t| scene.corners_of(t as usize)));
                decided.inward[c] = shell.volume() < 0.0;
                decided.shells[c] = Some(shell);
                if decided.inward[c] {
                    decided.turn_all(scene, c);
                }
            }
            let power = |t: u32| scene.area(t as usize) * f64::from(scene.emission(t as usize).element_sum());
            decided.glow[c] = component
                .triangles
                .iter()
                .map(|&t| (power(t), t))
                .filter(|(p, _)| *p > 0.0)
                .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))
                .map(|(_, t)| t);
        }
        decided
    }

    fn turn(&mut self, scene: &mut Scene, t: u32) {
        scene.turn(t as usize);
        self.turned[t as usize] ^= true;
    }

    fn turn_all(&mut self, scene: &mut Scene, c: usize) {
        let components = self.components;
        for &t in &components.list[c].triangles {
            self.turn(scene, t);
        }
    }

    /// Components that glow, the strongest triangles first.
    fn glowing(&self, scene: &Scene) -> Vec<usize> {
        let mut glowing: Vec<(f64, usize)> =
            (self.glow.iter().enumerate()).filter_map(|(c, t)| t.map(|t| (scene.area(t as usize), c))).collect();
        glowing.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        glowing.truncate(MOST_LIGHTS);
        glowing.into_iter().map(|(_, c)| c).collect()
    }

    fn turn_shut_lamps(&mut self, scene: &mut Scene) {
        let lamps: Vec<usize> = (self.glowing(scene).into_iter())
            .filter(|&c| {
                let material = self.glow[c].map(|t| scene.triangles[t as usize].material);
                self.kind[c] == SideKind::Sheet && !material.is_some_and(|m| scene.materials[m as usize].double_sided)
            })
            .collect();
        let lists: Vec<Vec<u32>> = (lamps.iter())
            .map(|&c| {
                let all = self.components.list[c].triangles.iter().copied();
                all.filter(|&t| scene.emission(t as usize) != Vec3::ZERO).collect()
            })
            .collect();
        for (&c, shut) in lamps.iter().zip(facing::shut(scene, &lists)) {
            if shut {
                self.turn_all(scene, c);
                let triangle = self.glow[c].unwrap_or(self.components.list[c].triangles[0]);
                self.shut.push(format!("\"{}\"", scene.meshes[scene.triangles[triangle as usize].mesh as usize]));
            }
        }
    }

    /// Turns the closed surfaces inwards that are rooms.
    fn find_rooms(&mut self, scene: &mut Scene) {
        let mut lights: Vec<DVec3> = (scene.lights.iter())
            .filter(|l| l.gives_light())
            .filter_map(|light| match light {
                Light::Rectangle { corner, edge_u, edge_v, .. } => Some(
                    (*corner + 0.5 * (*edge_u + *edge_v)).as_dvec3()
                        + IN_FRONT * edge_u.cross(*edge_v).as_dvec3().normalize_or_zero(),
                ),
                Light::Disc { centre, normal, .. } => Some((centre + normal * IN_FRONT as f32).as_dvec3()),
                Light::Point { position, .. } | Light::Spot { position, .. } => Some(position.as_dvec3()),
                Light::Sun { .. } | Light::Sky { .. } | Light::Environment(_) => None,
            })
            .take(MOST_LIGHTS)
            .collect();
        let glowing = self.glowing(scene);
        lights.extend(glowing.iter().filter_map(|&c| self.glow[c]).map(|t| {
            let [a, b, c] = scene.corners_of(t as usize).map(Vec3::as_dvec3);
            (a + b + c) / 3.0 + IN_FRONT * scene.normal(t as usize).as_dvec3()
        }));

        let mut room = vec![false; self.kind.len()];
        for light in lights {
            let mut around: Vec<(f64, usize)> = (self.shells.iter().enumerate())
                .filter_map(|(c, shell)| shell.as_ref().filter(|s| s.contains(light)).map(|s| (s.volume().abs(), c)))
                .collect();
            around.sort_by(|a, b| a.0.total_cmp(&b.0));
            for (_, c) in around.iter().step_by(2) {
                room[*c] = true;
            }
        }
        for c in glowing {
            room[c] |= self.shells[c].as_ref().is_some_and(|shell| self.glows_inwards(scene, c, shell));
        }
        for (c, _) in room.iter().enumerate().filter(|(_, room)| **room) {
            self.kind[c] = SideKind::Room;
            self.turn_all(scene, c);
        }
    }

    /// Whether closed surface `c`, which glows itself, is a room rather than a lamp.
    fn glows_inwards(&self, scene: &Scene, c: usize, shell: &Shell) -> bool {
        let (mut inside, mut outside) = (false, false);
        let others = self.components.list.iter().enumerate().filter(|(other, _)| *other != c);
        for (_, component) in others {
            // The centre of a triangle: its corners may touch the shell.
            let [p, q, r] = scene.corners_of(component.triangles[0] as usize).map(Vec3::as_dvec3);
            let contained = shell.contains((p + q + r) / 3.0);
            inside |= contained;
            outside |= !contained;
            if inside && outside {
                break;
            }
        }
        !outside || (self.inward[c] && inside)
    }

    /// Writes the decisions, and warnings of what was repaired.
    fn record(&self, scene: &mut Scene) {
        let mut decisions: Vec<(SideDecision, bool)> = Vec::with_capacity(self.kind.len());
        for (component, &kind) in self.components.list.iter().zip(&self.kind) {
            let mut meshes: Vec<u32> = component.triangles.iter().map(|&t| scene.triangles[t as usize].mesh).collect();
            meshes.dedup();
            meshes.sort_unstable();
            meshes.dedup();
            let turned = component.triangles.iter().filter(|&&t| self.turned[t as usize]).count();
            let mixed = component.triangles.iter().any(|&t| self.components.turn[t as usize]);
            let decision = SideDecision {
                components: 1,
                meshes: meshes.iter().take(4).map(|&m| scene.meshes[m as usize].clone()).collect(),
                triangles: component.triangles.len(),
                kind,
                turned,
            };
            decisions.push((decision, mixed));
        }
        self.warn(scene, &decisions);
        let mut decisions: Vec<SideDecision> = decisions.into_iter().map(|d| d.0).collect();
        // The sort is stable: components of one size stay in the order of the file.
        decisions.sort_by_key(|d| std::cmp::Reverse(d.triangles));
        let rest = decisions.split_off(decisions.len().min(MOST_DECISIONS));
        for decision in rest {
            match decisions[MOST_DECISIONS..].iter_mut().find(|d| d.kind == decision.kind) {
                Some(sum) => {
                    sum.components += 1;
                    sum.triangles += decision.triangles;
                    sum.turned += decision.turned;
                    for mesh in decision.meshes {
                        if sum.meshes.len() < 4 && !sum.meshes.contains(&mesh) {
                            sum.meshes.push(mesh);
                        }
                    }
                }
                None => decisions.push(decision),
            }
        }
        scene.sides = decisions;
    }

    fn warn(&self, scene: &mut Scene, decisions: &[(SideDecision, bool)]) {
        let name = |d: &SideDecision| format!("\"{}\"", d.meshes.join("\", \""));
        let some = |f: &dyn Fn(&(SideDecision, bool)) -> bool| -> Vec<String> {
            decisions.iter().filter(|d| f(d)).map(|d| name(&d.0)).collect()
        };
        let mixed = some(&|d| d.1);
        let inside_out =
            some(&|d| matches!(d.0.kind, SideKind::Solid | SideKind::Room) && !d.1 && d.0.turned == d.0.triangles);
        let moebius = some(&|d| d.0.kind == SideKind::NotOrientable);
        for (names, text) in [
            (mixed, "winding was inconsistent and was repaired in the components of meshes"),
            (inside_out, "closed surfaces were wound inside out and were turned around, meshes"),
            (moebius, "no consistent winding exists, both sides count, meshes"),
            (self.shut.clone(), "glowing surfaces faced away from the scene and were turned around, meshes"),
        ] {
            if !names.is_empty() {
                scene.warnings.push(format!("{text} {}", list(&names, 5)));
            }
        }
    }
}
