//! The same figures for parts of the episodes: per speed, object, force and so on.

use serde::Serialize;
use slipsense_synth::objects::{self, Group as ObjectGroup};

use super::figures::{EpisodeRecord, Figures};
use crate::truth::{EpisodeInfo, Truth};

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Group {
    /// What they have in common, `unknown` where the metadata does not say.
    pub(crate) value: String,
    pub(crate) figures: Figures,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Grouping {
    pub(crate) by: &'static str,
    pub(crate) groups: Vec<Group>,
    /// The group of the lowest macro F1: of those with slip, if there are any.
    pub(crate) worst: Option<String>,
}

/// Bounds between the terciles of the grip force, N; `None` where no episode states its grip.
pub(crate) fn grip_bounds_n<'a>(truths: impl IntoIterator<Item = &'a Truth>) -> Option<[f64; 2]> {
    let mut grips: Vec<f64> = truths.into_iter().filter_map(|truth| truth.info.grip_n).collect();
    grips.sort_by(f64::total_cmp);
    (!grips.is_empty()).then(|| [1, 2].map(|third| grips[third * grips.len() / 3]))
}

/// What an episode has in common with others of its group; none where its metadata does not say.
type Key<'a> = &'a dyn Fn(&EpisodeInfo) -> Option<String>;

pub(crate) fn groupings(episodes: &[(&Truth, &EpisodeRecord)]) -> Vec<Grouping> {
    let grip = grip_bounds_n(episodes.iter().map(|(truth, _)| *truth));
    let tercile = |info: &EpisodeInfo| {
        let (n, [low, high]) = (info.grip_n?, grip?);
        Some(match n {
            n if n < low => format!("1 below {low:.1} N"),
            n if n < high => format!("2 from {low:.1} to {high:.1} N"),
            _ => format!("3 from {high:.1} N"),
        })
    };
    let speed = |info: &EpisodeInfo| {
        Some(info.speed_mm_s.map_or("nothing pulls".to_owned(), |v| format!("{v} mm/s")))
    };
    // Models train on the first and are chosen on the second.
    let object_group = |info: &EpisodeInfo| {
        let group = match objects::named(info.object.as_deref()?)?.group {
            ObjectGroup::Train => "training",
            ObjectGroup::Val => "validation",
            ObjectGroup::HeldOut => "held out",
        };
        Some(group.to_owned())
    };
    let by: [(&'static str, Key<'_>); 10] = [
        ("input", &|info| Some(info.input.clone())),
        ("speed", &speed),
        ("object", &|info| info.object.clone()),
        ("object_group", &object_group),
        ("object_kind", &|info| info.object_kind.clone()),
        ("grip_tercile", &tercile),
        ("platform", &|info| info.platform.clone()),
        ("sensors", &|info| Some(info.sensors.to_string())),
        ("region", &|info| info.region.clone()),
        ("scenario", &|info| info.scenario.clone()),
    ];
    by.into_iter().map(|(by, key)| grouping(by, key, episodes)).collect()
}

fn grouping(by: &'static str, key: Key<'_>, episodes: &[(&Truth, &EpisodeRecord)]) -> Grouping {
    let key = |truth: &Truth| key(&truth.info).unwrap_or_else(|| "unknown".to_owned());
    let mut values: Vec<String> = episodes.iter().map(|(truth, _)| key(truth)).collect();
    values.sort_by(|a, b| number(a).total_cmp(&number(b)).then_with(|| a.cmp(b)));
    values.dedup();
    let group = |value: String| {
        let members = episodes.iter().filter(|(truth, _)| key(truth) == value);
        Group { figures: Figures::new(members.map(|(_, record)| *record)), value }
    };
    let groups: Vec<Group> = values.into_iter().map(group).collect();
    let f1 = |group: &&Group| group.figures.frame.macro_f1.unwrap_or(f64::INFINITY);
    // Without slip, a single frame of false slip makes a class's F1 zero.
    let still = |group: &&Group| group.figures.encoder_events.events == 0;
    let worst = groups.iter().min_by(|a, b| still(a).cmp(&still(b)).then(f1(a).total_cmp(&f1(b))));
    let worst = worst.map(|group| group.value.clone());
    Grouping { by, worst: worst.filter(|_| groups.len() > 1), groups }
}

/// The number that a value begins with, so that 10 mm/s comes after 5 mm/s.
fn number(value: &str) -> f64 {
    value.split(' ').next().and_then(|word| word.parse().ok()).unwrap_or(f64::INFINITY)
}
