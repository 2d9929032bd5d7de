//! Compressed raw messages, and the declared order in which a bus that cannot carry everything loses them: the slip
//! message never, then the rest of the taxels first, the contacts next, the accelerometer last.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::params::{MAX_SENSORS, TAXEL_COLS, TAXEL_TOUCH_MIN, TAXELS};
use slipsense::sensor::{PiezoFrame, SensorReadings};
use slipsense::tasks::{RAW_MESSAGES, RuntimeConfig, Shared};
use slipsense::wire::{RawMessage, Region};
use slipsense_can_sim::controller::Disturbance;

use super::world::{BATCH, Ran, World, assert_taxels, healthy};

const FRAMES: u32 = 480;
/// The contact of [`noise`].
const CONTACT: Region = Region { first_row: 10, rows: 6, first_col: 12, cols: 8 };

pub fn compress(shared: &Shared<embassy_sync::blocking_mutex::raw::NoopRawMutex>, tick: u32) {
    if tick == 0 {
        shared.set_config(RuntimeConfig { compress_raw: true, ..shared.config() });
    }
}

/// What no coder makes shorter: random samples, random counts, those of a touch in [`CONTACT`] alone.
fn noise(sequence: u32, parts: &mut [SensorReadings; MAX_SENSORS]) {
    healthy(sequence, parts);
    for (sensor, part) in (0u64..).zip(parts) {
        let mut rng = ChaCha8Rng::seed_from_u64(u64::from(sequence) << 8 | sensor);
        part.piezo = PiezoFrame::from_scan(std::array::from_fn::<u16, TAXELS, _>(|index| {
            let (row, col) = (index / TAXEL_COLS, index % TAXEL_COLS);
            if CONTACT.cols(row).contains(&col) {
                rng.random_range(TAXEL_TOUCH_MIN..4_096)
            } else {
                rng.random_range(0..TAXEL_TOUCH_MIN)
            }
        }));
        part.xl.iter_mut().for_each(|sample| *sample = rng.random());
    }
}

/// What arrived is what the sensors gave, as far as the message says that it holds it.
fn assert_true(message: &RawMessage) {
    let mut parts = [const { SensorReadings::new() }; MAX_SENSORS];
    noise(message.sequence, &mut parts);
    let part = &parts[usize::from(message.sensor)];
    assert_eq!((message.xl.as_slice(), message.xl_end), (part.xl.as_slice(), (message.sequence + 1) * BATCH));
    assert_taxels(message, &part.piezo);
}

/// Messages with all taxels, with those of the contact, without.
fn details(ran: &Ran) -> [usize; 3] {
    [Region::ALL, CONTACT, Region::NONE]
        .map(|region| ran.raw.iter().filter(|message| message.region == region).count())
}

/// [`noise`] of all sensors, compressed, on a bus with so much of others.
fn run(foreign_load_percent: u64) -> Ran {
    let disturbance = Disturbance { foreign_load_percent, ..Disturbance::default() };
    let world =
        World { disturbance, script: &noise, before_tick: &compress, ..World::new(FRAMES, MAX_SENSORS) };
    let ran = world.run();
    assert_eq!((ran.slips.len() as u32, ran.status.replaced_slips, ran.errors), (world.frames, 0, 0));
    ran.raw.iter().for_each(assert_true);
    assert_eq!(details(&ran).iter().sum::<usize>(), ran.raw.len());
    let made = world.frames * world.sensors as u32;
    let accounted = ran.raw.len() as u32 + ran.status.dropped_raw;
    assert_eq!(RAW_MESSAGES, 6, "two periods of three sensors");
    assert!((made - RAW_MESSAGES as u32..=made).contains(&accounted), "{accounted} of {made}");
    ran
}

/// Three sensors whose data no coder makes shorter ask for three times what the bus carries, and with others on it,
/// for more. The accelerometers of all arrive, contacts where there is room, all taxels where there is more.
#[test]
fn what_a_full_bus_loses_is_in_the_declared_order() {
    let mut before = [usize::MAX; 3];
    for foreign_load_percent in [0, 30, 50] {
        let ran = run(foreign_load_percent);
        let [all, contact, accelerometer] = details(&ran);
        // A message more than the bus takes fills the queue before the node has noticed: at the start above all.
        assert!(ran.status.dropped_raw * 50 <= FRAMES * MAX_SENSORS as u32, "{:?}", ran.status);
        assert!(contact > 0, "{ran:?}", ran = ran.status);
        assert!(all + contact <= before[0].saturating_add(before[1]), "{before:?}");
        before = [all, contact, accelerometer];
    }
}

#[test]
fn when_nothing_goes_the_rest_is_dropped_in_turn_and_counted() {
    let ran = run(85);
    assert!(ran.status.dropped_raw > 100, "{:?}", ran.status);
    let [_, _, accelerometer] = details(&ran);
    assert!(accelerometer * 10 > ran.raw.len() * 9, "{accelerometer} of {}", ran.raw.len());
    let shares = ran.shares();
    assert!(shares.iter().min().unwrap() * 4 > shares.iter().max().unwrap() * 3, "{shares:?}");
}
