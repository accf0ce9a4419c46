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
