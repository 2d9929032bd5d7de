//! The recipes of a split one after the other: what happens is interleaved in fixed proportions, and
//! objects and speeds take turns like the rows and columns of a Latin square.

use rand::seq::SliceRandom;
use sha2::{Digest, Sha256};

use super::split::Split;
use crate::draw::{Draw, Span, Stream, stream};
use crate::mix::{ANYWHERE, FREE, Mix, PROTOCOL, ScenarioChoice};
use crate::objects::{CATALOGUE, Group, Object};
use crate::recipe::{ObjectChoice, Platform, Recipe, Region, SPEEDS_MM_S, vary_two_of_three};

const NOSLIP_SECONDS: f64 = 60.0;

const TEST_AGE_MONTHS: Span = (4.0, 8.0);

const HANDS: [(Platform, usize); 4] =
    [(Platform::Umi, 2), (Platform::Tesollo, 2), (Platform::Umi, 2), (Platform::Tesollo, 3)];

/// Every fourth pull of `free` goes the rig's way, to tell what a hand changes from what the direction changes.
const VERTICAL_EVERY: usize = 4;

/// Seed of one episode: the first 53 bits of the SHA-256 of `slipsense/SPLIT/SEED/INDEX`, all in
/// decimal. Sets of other splits or seeds share no draws, and JSON carries 53 bits everywhere. Episodes of
/// `umi_quiet` have the seeds of those that they repeat.
pub(crate) fn episode_seed(split: Split, seed: u64, index: usize) -> u64 {
    hashed(&format!("slipsense/{split}/{seed}/{index}"))
}

/// The first 53 bits of a text's SHA-256.
pub(crate) fn hashed(text: &str) -> u64 {
    let digest = Sha256::digest(text.as_bytes());
    digest.iter().take(8).fold(0, |seed, &byte| seed << 8 | u64::from(byte)) >> 11
}

fn in_families(split: Split, recipe: Recipe) -> Recipe {
    match split.held_out_stages() {
        None => recipe,
        Some(stages) => stages.iter().fold(recipe.in_families(), |recipe, &stage| recipe.holding_out(stage)),
    }
}

/// Turn of the second of two things that take turns, so that all `n · m` pairs come before one repeats
/// and each `m` in a row differ but for every lcm(n, m)-th: a Latin square unrolled. The first has
/// turn `j % n`.
fn second_turn(j: usize, n: usize, m: usize) -> usize {
    let gcd = |mut a: usize, mut b: usize| {
        while b > 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    (j + j / (n * m / gcd(n, m))) % m
}

/// Angle of the `j`-th pull from the rig's direction, degrees from -150 to 180; the other directions come equally often.
fn pull_angle_deg(j: usize) -> f64 {
    if j % VERTICAL_EVERY == VERTICAL_EVERY - 1 {
        return 0.0;
    }
    let other = j - j / VERTICAL_EVERY;
    // Eleven directions, the full circle but the rig's: four steps of 30° at a time, so that neighbours in time are not
    // neighbours in direction.
    let angle_deg = 30.0 * (1 + (4 * other) % 11) as f64;
    if angle_deg > 180.0 { angle_deg - 360.0 } else { angle_deg }
}

/// Objects and speeds in the order of one split and seed, for one sort of event.
struct ObjectSchedule {
    objects: Vec<&'static Object>,
    speeds_mm_s: [f64; SPEEDS_MM_S.len()],
}

impl ObjectSchedule {
    fn shuffled(groups: &[Group], seed: u64) -> Self {
        let mut rng = stream(seed, Stream::Recipe, 0);
        let mut objects: Vec<_> = CATALOGUE.iter().filter(|o| groups.contains(&o.group)).collect();
        objects.shuffle(&mut rng);
        let mut speeds_mm_s = SPEEDS_MM_S;
        speeds_mm_s.shuffle(&mut rng);
        Self { objects, speeds_mm_s }
    }

    fn object(&self, j: usize) -> ObjectChoice {
        ObjectChoice::Named(self.objects[j % self.objects.len()].name.clone())
    }

    fn speed_mm_s(&self, j: usize) -> f64 {
        self.speeds_mm_s[second_turn(j, self.objects.len(), SPEEDS_MM_S.len())]
    }
}

/// What happens in the episodes of a split; `noslip` and `umi_quiet` have rules of their own.
fn mix(split: Split) -> Mix {
    match split {
        Split::Free => FREE,
        _ if split.held_out_stages().is_some() => ANYWHERE,
        _ => PROTOCOL,
    }
}

/// What happens, and how many times it happened before, for each place in one round of a mix.
fn round(mix: Mix) -> Vec<(usize, usize)> {
    let length: usize = mix.iter().map(|(_, weight)| weight).sum();
    let mut made = vec![0; mix.len()];
    (1..=length)
        .map(|place| {
            // The one that lags most behind its share; the first of equals.
            let lag = |&kind: &usize| (mix[kind].1 * place) as i64 - (made[kind] * length) as i64;
            let kind = (0..mix.len()).rev().max_by_key(lag).unwrap_or_default();
            made[kind] += 1;
            (kind, made[kind] - 1)
        })
        .collect()
}

pub(crate) struct Schedule {
    split: Split,
    seed: u64,
    round: Vec<(usize, usize)>,
    /// For each kind of event.
    object_schedules: Vec<ObjectSchedule>,
}

impl Schedule {
    pub(crate) fn new(split: Split, seed: u64) -> Self {
        let groups: &[Group] = match split {
            Split::Train | Split::UmiId | Split::TrainAnywhere => &[Group::Train],
            Split::Val | Split::ValAnywhere => &[Group::Val],
            Split::Noslip | Split::TransferNoslip => &[Group::Val, Group::HeldOut],
            // Repeats two others.
            Split::UmiQuiet => &[],
            _ => &[Group::HeldOut],
        };
        let mix = mix(split);
        // The 0 has no meaning any more: without it the frozen sets would be others.
        let objects = |kind| {
            ObjectSchedule::shuffled(groups, hashed(&format!("slipsense/{split}/{seed}/order/{kind}/0")))
        };
        Self { split, seed, round: round(mix), object_schedules: (0..mix.len()).map(objects).collect() }
    }

    pub(crate) fn recipe(&self, index: usize) -> Recipe {
        if self.split == Split::UmiQuiet {
            let repeated = Self::new([Split::UmiId, Split::UmiOod][index % 2], self.seed);
            return Recipe { rig_leak: false, ..repeated.recipe(index / 2) };
        }
        let recipe = Recipe::new(episode_seed(self.split, self.seed, index));
        let age_months = self.split.is_test().then(|| test_age_months(recipe.seed));
        let recipe = Recipe { age_months, ..recipe };
        if matches!(self.split, Split::Noslip | Split::TransferNoslip) {
            return in_families(self.split, noslip(recipe, &self.object_schedules[0], index));
        }
        let (kind, before) = self.round[index % self.round.len()];
        let (scenario, weight) = mix(self.split)[kind];
        let j = index / self.round.len() * weight + before;
        let objects = &self.object_schedules[kind];
        let (platform, sensors) = match self.split {
            Split::Tesollo2 => (Platform::Tesollo, 2),
            Split::Tesollo3 => (Platform::Tesollo, 3),
            // The trainer's sequences all have as many sensors.
            Split::TrainAnywhere => (HANDS[index % HANDS.len()].0, 2),
            _ if self.split.held_out_stages().is_some() => HANDS[index % HANDS.len()],
            _ => (Platform::Umi, 2),
        };
        let recipe = Recipe {
            object: objects.object(j),
            scenario,
            platform,
            region: if self.split == Split::Palm { Region::Palm } else { Region::Centre },
            sensors,
            speed_mm_s: (scenario != ScenarioChoice::FreeGrasp).then(|| objects.speed_mm_s(j)),
            pull_angle_deg: (scenario == ScenarioChoice::FreePull).then(|| pull_angle_deg(j)),
            ..recipe
        };
        in_families(self.split, recipe)
    }
}

/// Age of a test episode's arrays, to a tenth of a month: training ends where it begins.
fn test_age_months(seed: u64) -> f64 {
    (stream(seed, Stream::Recipe, 0).uniform(TEST_AGE_MONTHS) * 10.0).round() / 10.0
}

/// A minute of disturbances: objects and hands take turns.
fn noslip(recipe: Recipe, objects: &ObjectSchedule, turn: usize) -> Recipe {
    let (platform, sensors) = HANDS[second_turn(turn, objects.objects.len(), HANDS.len())];
    Recipe {
        object: objects.object(turn),
        scenario: ScenarioChoice::Disturbances,
        platform,
        sensors,
        seconds: Some(NOSLIP_SECONDS),
        ..recipe
    }
}

/// Names and recipes of minutes without slip like those of [`Split::Noslip`](super::Split::Noslip), but of validation
/// objects only, with seeds that no split has: what is chosen on them has seen nothing of a test. By turns of the
/// laboratory on the hand-held gripper, and of families of physics that training may see on both hands; each has every
/// object as often, two of three varied, so that no single object decides. A longer list begins with the shorter
/// one.
pub fn tuning_disturbances(episodes: usize) -> Vec<(String, Recipe)> {
    let objects = ObjectSchedule::shuffled(&[Group::Val], hashed("slipsense/tuning/order"));
    let recipe = |index: usize| {
        let recipe = noslip(Recipe::new(hashed(&format!("slipsense/tuning/{index}"))), &objects, index / 2);
        match index % 2 {
            0 => Recipe { platform: Platform::Umi, sensors: 2, ..recipe },
            _ => in_families(Split::ValAnywhere, recipe),
        }
    };
    let recipes = vary_two_of_three((0..episodes).map(recipe)).expect("valid recipes");
    (0..).map(|index| format!("tuning-{index:05}")).zip(recipes).collect()
}
