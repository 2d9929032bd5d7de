//! The power fails at every step of an update, of the swap, of confirming and of rolling back.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use slipsense::node::UpdateTarget::{Firmware, Model};
use slipsense::update::{ImageVersion, Refusal, Run};

use super::device::{Device, NEW, NEWEST, OLD, image, model, model_image};
use super::flash::Tear;

/// What a power cut leaves, and from which end an erase begins.
fn tears(seed: u64) -> [(Tear, bool); 5] {
    let chance = || Tear::Chance(Box::new(ChaCha8Rng::seed_from_u64(seed)));
    [(Tear::Nothing, false), (Tear::Half, false), (chance(), false), (chance(), true), (Tear::Zeros, true)]
}

/// The power fails after this number of steps, and leaves this.
fn cut(device: &Device, tear: Tear, backwards: bool, steps: u64) {
    let mut cells = device.cells.borrow_mut();
    (cells.tear, cells.backwards, cells.power) = (tear, backwards, steps);
}

/// Whatever happened, the device runs one firmware whole, keeps it once it has confirmed, and takes another.
fn is_well(device: &Device, what: &str) {
    let version = device.boots();
    assert!(version == OLD || version == NEW, "{what}: {version}");
    device.confirm();
    assert_eq!((device.boots(), device.run()), (version, Run::Confirmed), "{what}");
    assert_eq!(device.install(version, Firmware, &image(NEWEST)), Ok(()), "{what}");
    assert_eq!((device.boots(), device.run()), (NEWEST, Run::OnTrial), "{what}");
    assert_eq!((device.boots(), device.run()), (version, Run::RolledBack), "{what}");
}

/// Cut `act` at each of its steps, and again at steps of what puts it right. Prints how often; its steps.
fn cut_everywhere(name: &str, begin: &Device, act: impl Fn(&Device)) -> u64 {
    let whole = begin.twin();
    act(&whole);
    let steps = whole.steps() - begin.steps();
    let mut twice = 0;
    for step in 0..steps {
        for (tear, backwards) in tears(step) {
            let what = format!("cut at {step} of {steps}, {tear:?}, backwards {backwards}");
            let device = begin.twin();
            cut(&device, tear.clone(), backwards, step);
            act(&device);
            assert!(device.power_on(), "{what}");
            // Again, while the bootloader puts it right.
            let right = device.twin();
            let before = right.steps();
            right.boots();
            let needed = right.steps() - before;
            for again in (0..needed).filter(|again| (again + step) % 41 == 0) {
                let device = device.twin();
                cut(&device, tear.clone(), backwards, again);
                let _ = device.boot();
                assert!(device.power_on(), "{what}");
                is_well(&device, &format!("{what}, again at {again}"));
                twice += 1;
            }
            is_well(&device, &what);
        }
    }
    println!("{name}: {steps} steps, each cut in 5 ways, {twice} of them cut again");
    steps
}

#[test]
fn an_update_is_cut_anywhere() {
    let steps = cut_everywhere("writing an update", &Device::new(), |device| {
        let _ = device.install(OLD, Firmware, &image(NEW));
    });
    assert!(steps > 100);
}

#[test]
fn a_swap_and_its_confirmation_are_cut_anywhere() {
    let steps = cut_everywhere("swap and confirmation", &Device::updating(), |device| {
        if device.boot().is_ok() {
            device.try_confirm();
        }
    });
    assert!(steps > 300);
}

#[test]
fn a_rollback_is_cut_anywhere() {
    let device = Device::on_trial();
    let steps = cut_everywhere("rollback", &device, |device| {
        let _ = device.boot();
    });
    assert!(steps > 300);
    // Whenever it was cut, it ends with the old one.
    for step in 0..steps {
        let device = device.twin();
        device.power_fails_after(step);
        assert!(device.boot().is_err() && device.power_on());
        assert_eq!(device.boots(), OLD, "cut at {step}");
    }
}

#[test]
fn a_model_update_is_cut_anywhere() {
    let begin = Device { floor: OLD, ..Device::new() };
    let older = model_image(ImageVersion { patch: 0, ..OLD }, 3);
    assert_eq!(begin.install(OLD, Model, &model_image(OLD, 1)), Ok(()));
    let whole = begin.twin();
    let file = model_image(NEW, 2);
    assert_eq!(whole.install(OLD, Model, &file), Ok(()));
    let steps = whole.steps() - begin.steps();
    let mut built_in = 0;
    for step in 0..steps {
        for (tear, backwards) in tears(step) {
            let device = begin.twin();
            cut(&device, tear, backwards, step);
            assert!(device.install(OLD, Model, &file).is_err());
            assert!(device.power_on());
            match device.model() {
                Ok((version, bytes)) if version == OLD => assert_eq!(bytes, model(1), "cut at {step}"),
                Ok((version, _)) => panic!("cut at {step}: version {version}"),
                Err(why) => {
                    assert_ne!(why, Refusal::Flash);
                    built_in += 1;
                }
            }
            assert_eq!(device.boots(), OLD);
            // The one that has confirmed is the floor, whatever is left of the slot.
            assert_eq!(device.install(OLD, Model, &older), Err(Refusal::Older.reason()), "cut at {step}");
            assert_eq!(device.install(OLD, Model, &file), Ok(()), "cut at {step}");
            assert_eq!(device.model(), Ok((NEW, model(2))));
        }
    }
    println!("writing a model: {steps} steps, each cut in 5 ways, {built_in} left the model in the firmware");
    assert!(built_in > steps);
}
