//! Bakes to a target or a time.

mod common;

use std::time::{Duration, Instant};

use common::{World, options};
use glam::DVec3;
use luxel::{Goal, Scene, bake::Bake, options::Resolution, progress::Silent};

fn room() -> Scene {
    let mut world = World::new();
    let (wall, lamp) = (world.grey(0.7, 0.0), world.grey(0.2, 5.0));
    world.room(DVec3::ZERO, DVec3::new(1.3, 1.0, 0.8), wall);
    world.block(DVec3::new(0.31, 0.2, 0.0), DVec3::new(0.6, 0.53, 0.35), wall);
    world.quad("lamp", DVec3::new(0.4, 0.4, 0.75), DVec3::Y * 0.3, DVec3::X * 0.3, lamp);
    world.build().scene
}

fn bake(goal: &Goal) -> Bake {
    let options = luxel::BakeOptions { estimate: true, ..options(64, 256) };
    luxel::bake_to(&room(), &options, goal, &Silent).unwrap()
}

fn total(bake: &Bake) -> f64 {
    bake.report.error.as_ref().expect("an estimate").total.total
}

#[test]
fn a_target_is_reached_with_the_same_settings_and_bits_every_time() {
    let goal = Goal { target_error: Some(0.012), ..Goal::default() };
    let (first, second) = (bake(&goal), bake(&goal));
    let report = first.report.goal.as_ref().expect("a search");
    assert!(total(&first) <= 0.012 && report.reached == Some(true), "{report:?}");
    assert!(report.steps.len() <= 5, "{report:?}");
    // Laws hold: a step ends within half and twice of what was expected of it.
    for step in &report.steps[1..] {
        let ratio = step.error.expect("it ended") / step.expected.expect("not the first");
        assert!((0.5..2.0).contains(&ratio), "{report:?}");
    }
    assert_eq!(first.vertices.indirect, second.vertices.indirect);
    assert_eq!(first.vertices.direct, second.vertices.direct);
}

#[test]
fn settings_that_were_given_stay_and_what_they_forbid_is_not_promised() {
    let goal = Goal { target_error: Some(1e-5), fixed_resolution: true, fixed_rays: true, ..Goal::default() };
    let given = luxel::BakeOptions { estimate: true, ..options(6, 32) };
    let bake = luxel::bake_to(&room(), &given, &goal, &Silent).unwrap();
    let (report, settings) = (bake.report.goal.as_ref().unwrap(), bake.report.settings.as_ref().unwrap());
    assert_eq!((settings.resolution, settings.rays), (Resolution::Grid(6), 32));
    assert_eq!(report.reached, Some(false));
    let errors: Vec<f64> = report.steps.iter().filter_map(|s| s.error).collect();
    assert_eq!(total(&bake), errors.iter().copied().fold(f64::INFINITY, f64::min));
}

#[test]
fn a_budget_gives_the_best_bake_that_was_finished() {
    let begun = Instant::now();
    let bake = bake(&Goal { budget: Some(Duration::from_millis(800)), ..Goal::default() });
    let report = bake.report.goal.as_ref().expect("a search");
    let steps: f64 = report.steps.iter().map(|s| s.seconds).sum();
    assert!(steps <= report.seconds && report.seconds <= begun.elapsed().as_secs_f64());
    // The best of those that were finished; whatever else the machine does, the first is.
    let finished: Vec<f64> = report.steps.iter().filter_map(|s| s.error).collect();
    assert_eq!(total(&bake), finished.iter().copied().fold(f64::INFINITY, f64::min));
    assert!(report.steps[0].error.is_some() && report.reached.is_none(), "{report:?}");
}

#[test]
fn no_time_at_all_is_one_coarse_bake() {
    let bake = bake(&Goal { budget: Some(Duration::from_nanos(1)), target_error: Some(1e-6), ..Goal::default() });
    let report = bake.report.goal.as_ref().expect("a search");
    assert_eq!((report.steps.len(), report.reached), (1, Some(false)));
    assert!(!bake.vertices.indirect.is_empty());
}

#[test]
fn a_goal_without_sense_or_estimate_is_refused() {
    let scene = room();
    let refused = |options: &luxel::BakeOptions, goal: Goal| {
        luxel::bake_to(&scene, options, &goal, &Silent).err().expect("no sense").to_string()
    };
    let good = luxel::BakeOptions { estimate: true, ..options(8, 16) };
    for target in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let message = refused(&good, Goal { target_error: Some(target), ..Goal::default() });
        assert!(message.contains("must be above 0"), "{message}");
    }
    let message = refused(&options(8, 16), Goal { target_error: Some(0.1), ..Goal::default() });
    assert!(message.contains("needs the estimate"), "{message}");
}
