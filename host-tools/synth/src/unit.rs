//! The sensors as built. There are five, drawn once from constant seeds, as a laboratory has them: two on
//! the jaws of the UMI, for all its recordings, and three others on the fingers of the Tesollo.

use serde::Serialize;

use crate::accelerometer::XlUnit;
use crate::draw::{Draw, Rng, Stream, stream};
use crate::families::PathFamily;
use crate::film::FilmUnit;
use crate::recipe::Platform;
use crate::vibration::Modes;

/// Seed of the units. The idle pads of all five read less than half the contact threshold, which one
/// threshold for every unit asks for: creep after a release must not count as contact for long.
const UNITS_SEED: u64 = 0x51f5_002b;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum UnitId {
    UmiA,
    UmiB,
    TesolloA,
    TesolloB,
    TesolloC,
}

impl UnitId {
    const ALL: [Self; 5] = [Self::UmiA, Self::UmiB, Self::TesolloA, Self::TesolloB, Self::TesolloC];

    /// The units of a recording, in the order of its sensors: those of the platform in any order.
    pub(crate) fn mounted(rng: &mut Rng, platform: Platform, sensors: usize) -> Vec<Self> {
        let mut units: Vec<_> = Self::ALL.into_iter().filter(|id| id.platform() == platform).collect();
        for last in (1..units.len()).rev() {
            units.swap(last, rng.count(0, last));
        }
        units.truncate(sensors);
        units
    }

    fn platform(self) -> Platform {
        if matches!(self, Self::UmiA | Self::UmiB) { Platform::Umi } else { Platform::Tesollo }
    }
}

pub(crate) struct Unit {
    pub film: FilmUnit,
    pub modes: Modes,
    pub xl: XlUnit,
}

impl Unit {
    pub(crate) fn new(id: UnitId) -> Self {
        Self::draw(&mut stream(UNITS_SEED, Stream::Unit, id as usize), id)
    }

    /// One of an episode alone, in the place of `id`.
    pub(crate) fn of_episode(seed: u64, sensor: usize, id: UnitId, path: PathFamily) -> Self {
        let mut rng = stream(seed, Stream::Unit, sensor);
        let unit = Self::draw(&mut rng, id);
        let modes = if path == PathFamily::FreeModes { Modes::draw_free(&mut rng) } else { unit.modes };
        Self { modes, ..unit }
    }

    fn draw(rng: &mut Rng, id: UnitId) -> Self {
        let mut film = FilmUnit::draw(rng);
        let (modes, xl) = (Modes::draw(rng, id.platform()), XlUnit::draw(rng));
        film.circuit.draw_amplifiers(rng);
        Self { film, modes, xl }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::within;
    use crate::contact::PressureMap;
    use crate::film::{Film, FilmSession};
    use slipsense::params::CONTACT_SUM_MIN;

    #[test]
    fn idle_pads_of_all_units_read_less_than_half_the_contact_threshold() {
        for id in UnitId::ALL {
            let unit = Unit::new(id);
            for recording in 0..40 {
                let mut rng = stream(recording, Stream::Film, 0);
                let session = FilmSession { faults: Vec::new(), ..FilmSession::draw(&mut rng, 1.0) };
                let mut film = Film::new(&unit.film, session, rng);
                let sums = (0..120).map(|frame| film.scan(frame, &PressureMap::empty(), 0.0, |_| 1.0).sum());
                let level = f64::from(sums.sum::<u32>()) / 120.0 / f64::from(CONTACT_SUM_MIN);
                within(format!("{id:?}: idle over the contact threshold"), level, ..0.5);
            }
        }
    }
}
