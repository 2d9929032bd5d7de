//! What the path is measured with: nothing on the pads, the contact of the demo episode, and all that the
//! sensors can deliver.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::params::{CONTACT_SUM_MIN, FRAME_RATE_HZ, TAXELS, XL_AXES, XL_RATE_HZ};
use slipsense::pipeline::FrameStamp;
use slipsense::sensor::{PiezoFrame, SensorReadings, TaxelMask};
use slipsense_recording::Episode;

use crate::process::{DEMO_EPISODE, root};
use crate::qemu::frames::Frames;

/// LSB of an accelerometer at 1 g, about.
const GRAVITY_LSB: i16 = 2_000;
const SEED: u64 = 1;
/// Beside the repository, where someone has them.
const REAL_EPISODES: &str = "../shared/real";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// Untouched pads and a quiet accelerometer.
    Idle,
    /// The demo episode while something is held.
    Typical,
    /// Every taxel large and different in each frame, the accelerometer at full swing.
    Full,
    /// Nothing at all: every count and every sample is 0.
    Zero,
    Random,
}

impl Input {
    pub const ALL: [Self; 3] = [Self::Idle, Self::Typical, Self::Full];
    pub const COMPRESSED: [Self; 5] = [Self::Zero, Self::Idle, Self::Typical, Self::Full, Self::Random];

    pub fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle pads",
            Self::Typical => "typical contact",
            Self::Full => "full contact",
            Self::Zero => "all zero",
            Self::Random => "random bits",
        }
    }

    /// `count` frames of it.
    pub fn frames(self, sensors: usize, count: usize) -> Result<Frames> {
        // How far the accelerometer swings, and a taxel's count. Idle: one taxel in four reads one count, which stays
        // below the threshold of a touch.
        let (xl_swing, count_of): (i16, fn(&mut ChaCha8Rng) -> u16) = match self {
            Self::Typical => return typical(sensors, count),
            Self::Idle => (40, |rng| u16::from(rng.random_ratio(1, 4))),
            Self::Full => (30_000, |rng| rng.random_range(1_000..=4_095)),
            Self::Zero => (0, |_| 0),
            Self::Random => (i16::MAX, |rng| rng.random_range(0..=4_095)),
        };
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        let mut part = |xl_end: u32, batch: u32| {
            let mut sample =
                || std::array::from_fn::<i16, XL_AXES, _>(|_| rng.random_range(-xl_swing..=xl_swing));
            let xl =
                (0..batch).map(|_| sample()).map(|[x, y, z]| [x, y, z.saturating_add(GRAVITY_LSB)]).collect();
            SensorReadings {
                piezo: PiezoFrame::from_scan(std::array::from_fn::<_, TAXELS, _>(|_| count_of(&mut rng))),
                piezo_arrived: true,
                xl,
                stuck: TaxelMask::NONE,
                xl_arrived: true,
                xl_end,
            }
        };
        let xl_end = |frame: u32| frame * XL_RATE_HZ / FRAME_RATE_HZ;
        let frame = |frame| {
            let (begin, end) = (xl_end(frame), xl_end(frame + 1));
            (FrameStamp::of_recording(frame), (0..sensors).map(|_| part(end, end - begin)).collect())
        };
        Ok(Frames::new(sensors, (0..count as u32).map(frame).collect()))
    }
}

pub fn demo() -> Result<Episode> {
    Episode::read(root().join(DEMO_EPISODE)).context("the demo episode")
}

/// The demo episode from its first touched frame on; a third sensor feels what the first does.
fn typical(sensors: usize, count: usize) -> Result<Frames> {
    let episode = demo()?;
    let touched = |frame: &usize| {
        (0..episode.sensors).all(|sensor| episode.piezo(*frame, sensor).sum() >= CONTACT_SUM_MIN)
    };
    let first = (0..episode.frames()).find(touched).context("the demo episode holds no contact")?;
    let held = (first..episode.frames()).take_while(touched).count();
    ensure!(held >= count, "the demo episode holds {held} frames of contact, {count} are asked for");
    let mut list = Frames::from_episode(&episode, None)?.list;
    list = list.drain(first..first + count).collect();
    list.iter_mut().for_each(|(_, parts)| *parts = parts.iter().cycle().take(sensors).cloned().collect());
    Ok(Frames::new(sensors, list))
}

/// The files of episodes composed from real recordings, where someone has them: they cannot be part of the repository.
pub fn real_episodes() -> Result<Vec<PathBuf>> {
    let Ok(dir) = root().join(REAL_EPISODES).read_dir() else { return Ok(Vec::new()) };
    let mut paths = dir.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "npz"));
    paths.sort();
    if paths.is_empty() {
        eprintln!("no episodes of real recordings in {REAL_EPISODES}");
    }
    Ok(paths)
}
