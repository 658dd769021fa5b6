//! What belongs where, of the library and of the scenes that come along.

use reel_generate::{
    scene::{built_in, names},
    task::Compatibility,
};
use reel_tasks::library::objects;

#[test]
fn every_object_and_every_receptacle_of_the_built_in_scenes_is_spoken_of() {
    let table = Compatibility::committed();
    for object in objects() {
        assert!(table.knows_object(object), "{} ({})", object.category, object.purpose);
    }
    for name in names() {
        for receptacle in built_in(name).unwrap().receptacles {
            let held = objects().iter().filter(|object| table.holds(&receptacle, object)).count();
            assert!(held >= 50, "{name}: {} holds {held} objects", receptacle.id);
        }
    }
}
