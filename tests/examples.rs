//! The examples do what they say.

use luxel::{BakeOptions, options::Resolution, progress::Silent, scene::SurfacePoint};

#[allow(dead_code)]
#[path = "../examples/in_memory.rs"]
mod in_memory;

#[test]
fn the_stages_one_by_one_give_the_light_of_the_whole_bake() {
    let options = BakeOptions { resolution: Resolution::Grid(24), ..BakeOptions::default() };
    let scene = in_memory::room().unwrap();
    let floor: SurfacePoint = in_memory::floor(&scene);
    let staged = in_memory::indirect_by_stages(&scene, &options, floor).unwrap();
    let bake = luxel::bake(&scene, &options, &Silent).unwrap();
    assert_eq!(staged, bake.irradiance(&[floor], &Silent).indirect[0]);
    // The red wall reflects a fraction of green and blue.
    assert!(staged.x > 1.2 * staged.y && staged.y > 0.0, "{staged}");
}

#[allow(dead_code)]
#[path = "../examples/relight.rs"]
mod relight;

#[test]
fn a_lamp_that_goes_round_a_square_room_gives_the_same_light_in_every_corner() {
    let frames = relight::tour().unwrap();
    // A quarter of a turn is a symmetry of all but the red wall, which reflects a third of what the others do and is one of
    // six: what the others lose by that is below a sixth. Direct light has no such excuse: its error is that of sampling.
    for (k, quarter) in frames.iter().zip(frames.iter().cycle().skip(6)).take(24).enumerate() {
        let (a, b) = quarter;
        assert!((a.direct / b.direct - 1.0).abs() < 0.01, "{k}: {} {}", a.direct, b.direct);
        assert!((a.indirect / b.indirect - 1.0).abs() < 1.0 / 6.0, "{k}: {} {}", a.indirect, b.indirect);
        assert!(a.direct > 0.0 && a.indirect > 0.0, "{k}");
    }
}
