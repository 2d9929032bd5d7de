//! The power fails at every step of a sequence of stores; after it, the old or the new configuration is there.

use embassy_futures::block_on;
use rand::{RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::calibration::{Calibration, RECORD_BYTES, Trim};
use slipsense::settings::{Origin, SCRATCH, Scratch, Setting, Settings, SettingsStore, StoreError};

use crate::update::flash::{Cells, Tear};

/// A small sector, so that a few stores fill both.
const SECTOR: usize = 2048;
const STORES: u64 = 12;

/// Configuration number `n`, different from all others; number 0 is the defaults.
fn configuration(n: u64) -> Settings {
    let mut settings = Settings::new();
    if n > 0 {
        let mut rng = ChaCha8Rng::seed_from_u64(n);
        let mut mask = || (0..32).map(|_| i64::from(rng.next_u32())).collect::<Vec<_>>();
        settings.set(Setting::TaxelMask0, &mask()).unwrap();
        settings.set(Setting::TaxelMask2, &mask()).unwrap();
        settings.set(Setting::NodeId, &[n as i64]).unwrap();
    }
    settings
}

type Store<const BYTES: usize> = SettingsStore<Cells<BYTES>, Box<Scratch>>;

fn store_of<const BYTES: usize>(flash: Cells<BYTES>) -> Store<BYTES> {
    let range = flash.range();
    SettingsStore::new(flash, range, Box::new(SCRATCH)).unwrap()
}

fn tear(torn: bool, cut: u64) -> Tear {
    if torn { Tear::Chance(Box::new(ChaCha8Rng::seed_from_u64(cut))) } else { Tear::Nothing }
}

/// Store configurations `from` to [`STORES`]; the number of the last one whose store returned well.
fn stores(flash: Cells<SECTOR>, from: u64) -> (u64, Option<StoreError>, Cells<SECTOR>) {
    let mut store = store_of(flash);
    for n in from..=STORES {
        if let Err(error) = block_on(store.store(&configuration(n))) {
            return (n - 1, Some(error), store.into_flash());
        }
    }
    (STORES, None, store.into_flash())
}

#[test]
fn a_power_cut_at_any_step_leaves_the_old_or_the_new_configuration() {
    let (last, error, whole) = stores(Cells::new(2, 1), 1);
    assert_eq!((last, error), (STORES, None));
    let (steps, erases) = (whole.steps, whole.erases);
    assert!(erases >= 3, "both sectors are filled and erased: {erases} erases");
    let (mut old, mut new) = (0u32, 0u32);
    for (cut, torn) in (0..steps).flat_map(|cut| [(cut, false), (cut, true)]) {
        let (done, error, mut flash) =
            stores(Cells { power: cut, tear: tear(torn, cut), ..Cells::new(2, 1) }, 1);
        assert!(error.is_some() && done < STORES, "cut at {cut}");
        // The second power cut comes while what the first one left is being looked at and mended.
        for second in [u64::MAX, cut % 97] {
            let mut store = store_of(Cells { power: second, ..flash });
            let _ = block_on(store.load());
            flash = store.into_flash();
            flash.power = u64::MAX;
            let mut store = store_of(flash.clone());
            let (found, report) = block_on(store.load());
            if found == configuration(done) {
                old += 1;
            } else if found == configuration(done + 1) {
                new += 1;
            } else {
                panic!("cut at {cut}, {done} stored: {report:?}, {found:?}");
            }
            if done > 0 {
                assert_eq!(report.origin, Origin::Stored, "cut at {cut}");
            }
            assert_eq!(report.damage.settings, 0, "cut at {cut}");
            // And the flash still works.
            block_on(store.store(&configuration(77))).unwrap_or_else(|error| panic!("cut at {cut}: {error}"));
            let (found, report) = block_on(store.load());
            assert_eq!((found, report.is_damaged()), (configuration(77), false), "cut at {cut}");
        }
    }
    println!(
        "settings: {STORES} stores, {steps} steps with {erases} erases, power cut at every one, cleanly and with \
         torn bits, and once more while loading: {old} times the old configuration, {new} times the new one"
    );
    assert!(old > 0 && new > 0);
}

/// On the board the store that empties a full sector must end within a command's time, 8 s: the sector's items are read
/// and checked once each, not once for every other.
#[test]
fn the_sectors_of_the_h7_hold_hundreds_of_configurations() {
    const BYTES: usize = 128 * 1024;
    let mut flash = Cells::<BYTES>::new(2, 1);
    let mut most = 0;
    for n in 0..400 {
        // A board that was started anew.
        let mut store = store_of(Cells { bytes_read: 0, ..flash });
        block_on(store.store(&configuration(n % 100))).unwrap();
        flash = store.into_flash();
        most = most.max(flash.bytes_read);
    }
    assert!(flash.erases <= 3, "{} erases", flash.erases);
    println!("settings: a store reads at most {most} bytes");
    assert!(most < 4 * BYTES as u64, "a store reads {most} bytes");
    let mut store = store_of(flash);
    assert_eq!(block_on(store.load()).0, configuration(99));
}

#[test]
fn damage_is_reported_and_mended() {
    let mut store = store_of(Cells::<SECTOR>::new(2, 1));
    let (settings, report) = block_on(store.load());
    assert_eq!((settings, report.origin, report.is_damaged()), (Settings::new(), Origin::Blank, false));
    block_on(store.store(&configuration(5))).unwrap();
    let good = store.into_flash();

    // Any one damaged byte: the configuration or the defaults, with a report; never anything else.
    let used = good.bytes.iter().rposition(|&byte| byte != 0xFF).unwrap();
    let (mut kept, mut lost) = (0, 0);
    for at in 0..=used {
        let mut damaged = good.clone();
        damaged.bytes[at] ^= 0x10;
        let mut store = store_of(damaged);
        let (found, report) = block_on(store.load());
        if found == configuration(5) {
            kept += 1;
        } else {
            assert_eq!((found, report.is_damaged()), (Settings::new(), true), "byte {at}: {report:?}");
            lost += 1;
        }
        block_on(store.store(&configuration(6))).unwrap_or_else(|error| panic!("byte {at}: {error}"));
        assert_eq!(block_on(store.load()).0, configuration(6), "byte {at}");
    }
    let bytes = used + 1;
    println!(
        "settings: one damaged byte of {bytes}: {kept} times harmless, {lost} times defaults and a report"
    );
    assert!(lost > 400);

    // A calibration beside them does not hide it.
    let mut store = store_of(Cells::<{ 16 * 1024 }>::new(2, 1));
    block_on(store.store(&configuration(5))).unwrap();
    block_on(store.store_calibration(1, &calibration(2))).unwrap();
    let mut flash = store.into_flash();
    flash.bytes[100] ^= 0x10;
    let mut store = store_of(flash);
    assert!(block_on(store.load()).1.is_damaged());
    assert_eq!(loaded(&mut store, 1), calibration(2));

    // Nothing but zeros.
    let mut store = store_of(Cells { bytes: vec![0; good.bytes.len()], ..good });
    let (found, report) = block_on(store.load());
    assert_eq!((found, report.is_damaged()), (Settings::new(), true));
    block_on(store.store(&configuration(7))).unwrap();
    assert_eq!(block_on(store.load()).0, configuration(7));
}

#[test]
fn a_refused_write_is_an_error_and_harmless() {
    let mut store = store_of(Cells::<SECTOR> { power: 0, ..Cells::new(2, 1) });
    assert_eq!(block_on(store.store(&configuration(1))), Err(StoreError::Flash));
    let scratch = || Box::new(SCRATCH);
    assert!(SettingsStore::new(Cells::<SECTOR>::new(1, 1), 0..SECTOR as u32, scratch()).is_err());
    assert!(SettingsStore::new(Cells::<SECTOR>::new(3, 1), 1..2 * SECTOR as u32, scratch()).is_err());
    assert!(SettingsStore::new(Cells::<512>::new(4, 1), 0..2048, scratch()).is_err());
}

/// Calibration number `n` of an array, different from all others; number 0 is nominal.
fn calibration(n: u16) -> Box<Calibration> {
    let mut calibration = Box::new(Calibration::zeroed());
    calibration.set_nominal();
    for step in 0..n {
        calibration.trims[usize::from(step)] = Trim { gain: 2_000 - step, ..Trim::NOMINAL };
        calibration.faulty = calibration.faulty.with(usize::from(step), 7);
        assert!(calibration.scale(2_048), "the same gains, the next version");
    }
    // As it comes back: a stored taxel has the gate of its noise.
    if n > 0 {
        let mut record = vec![0; RECORD_BYTES];
        assert_eq!(calibration.encode(&mut record), Some(RECORD_BYTES));
        assert!(calibration.decode(&record));
    }
    calibration
}

fn loaded<const BYTES: usize>(store: &mut Store<BYTES>, connector: usize) -> Box<Calibration> {
    let mut found = calibration(0);
    assert!(block_on(store.load_calibration(connector, &mut found)), "connector {connector}");
    found
}

#[test]
fn a_power_cut_leaves_the_old_or_the_new_calibration_and_all_the_rest() {
    // Items of 6 KB: four of them and the settings fill a sector, so that there is a cut in each erase too.
    const LARGE: usize = 32 * 1024;
    let made: Vec<_> = (0..=7).map(calibration).collect();
    let stores = |flash: Cells<LARGE>| {
        let mut store = store_of(flash);
        let mut done = 0;
        for n in 1..=6 {
            if block_on(store.store_calibration(usize::from(n % 2), &made[usize::from(n)])).is_err() {
                break;
            }
            done = n;
        }
        (done, store.into_flash())
    };
    let mut first = store_of(Cells::<LARGE>::new(2, 1));
    block_on(first.store(&configuration(5))).unwrap();
    block_on(first.store_calibration(2, &made[7])).unwrap();
    assert_eq!(block_on(first.model_floor()), [0; 4]);
    block_on(first.store_model_floor([1, 2, 3, 4])).unwrap();
    let first = first.into_flash();
    let (done, whole) = stores(first.clone());
    assert_eq!(done, 6);
    assert!(whole.erases >= 1, "{} erases", whole.erases);
    let (mut old, mut new) = (0u32, 0u32);
    let steps = whole.steps - first.steps;
    for cut in (0..steps).step_by(1_501) {
        let (done, mut flash) = stores(Cells { power: cut, tear: tear(cut % 2 == 0, cut), ..first.clone() });
        flash.power = u64::MAX;
        let mut store = store_of(flash);
        let last = |connector: u16, upto: u16| (0..=upto).rev().find(|n| *n == 0 || n % 2 == connector);
        let during = done + 1;
        for connector in 0..2 {
            let found = loaded(&mut store, connector.into());
            let (before, after) = (last(connector, done).unwrap(), last(connector, during).unwrap());
            if found == made[usize::from(before)] {
                old += u32::from(before != after);
            } else {
                assert_eq!(found, made[usize::from(after)], "cut at {cut}, connector {connector}");
                new += 1;
            }
        }
        assert_eq!(loaded(&mut store, 2), made[7], "cut at {cut}");
        assert_eq!(block_on(store.model_floor()), [1, 2, 3, 4], "cut at {cut}");
        assert_eq!(block_on(store.load()).0, configuration(5), "cut at {cut}");
        block_on(store.store_calibration(1, &made[3])).unwrap();
        assert_eq!(loaded(&mut store, 1), made[3], "cut at {cut}: the flash still works");
    }
    println!(
        "calibrations: 6 stores, {steps} steps, power cut at every 1,501st: {old} times old, {new} times new"
    );
    assert!(old > 20);
}

#[test]
fn a_calibration_before_any_setting_is_no_damage_and_can_be_forgotten() {
    let mut store = store_of(Cells::<{ 16 * 1024 }>::new(2, 1));
    block_on(store.store_calibration(1, &calibration(2))).unwrap();
    assert_eq!(block_on(store.load()).0, Settings::new());
    assert_eq!(block_on(store.load()).1.origin, Origin::Stored);
    assert_eq!((loaded(&mut store, 0), loaded(&mut store, 1)), (calibration(0), calibration(2)));
    block_on(store.store_calibration(1, &calibration(0))).unwrap();
    assert_eq!(loaded(&mut store, 1), calibration(0));
    assert!(!calibration(1).decode(&[1; RECORD_BYTES]));
}

#[test]
fn what_is_stored_already_is_not_written_again() {
    let mut store = store_of(Cells::<{ 16 * 1024 }>::new(2, 1));
    block_on(store.store(&configuration(5))).unwrap();
    block_on(store.store_calibration(1, &calibration(2))).unwrap();
    let mut flash = store.into_flash();
    let steps = flash.steps;
    for _ in 0..100 {
        let mut store = store_of(flash);
        block_on(store.store(&configuration(5))).unwrap();
        block_on(store.store_calibration(1, &calibration(2))).unwrap();
        // Forgotten, and never measured.
        block_on(store.store_calibration(0, &calibration(0))).unwrap();
        flash = store.into_flash();
    }
    assert_eq!(flash.steps, steps);
}
