//! Scenario → contact and partial slip → film and vibration → counts and samples → labels.

use std::ops::Range;

use rayon::prelude::*;
use serde_json::json;
use slipsense::params::FRAME_RATE_HZ;
use slipsense::sensor::PiezoFrame;
use slipsense_recording::{Episode, Meta};

use crate::draw::{Stream, stream};
use crate::draw_log::DrawLog;
use crate::finger::{EpisodeSetup, Finger, mean};
use crate::labels::{self, Encoder, Rule};
use crate::recipe::{Recipe, ResolvedRecipe, SynthError};
use crate::scenario::script::Script;
use crate::scenario::{self, Plan};
use crate::vibration::{self, SlipSeries};

const FRAME_HZ: f64 = FRAME_RATE_HZ as f64;

/// Number of frames of the episode that [`generate`] makes of a recipe, without making it.
pub fn plan_frames(recipe: &Recipe) -> Result<usize, SynthError> {
    let resolved = recipe.resolve()?;
    Ok(frames(&script(recipe, &resolved)))
}

fn script(recipe: &Recipe, resolved: &ResolvedRecipe) -> Script {
    Script::draw(&mut stream(recipe.seed, Stream::Script, 0), resolved)
}

pub(crate) fn frames(script: &Script) -> usize {
    (script.seconds * FRAME_HZ).floor() as usize
}

/// Generate one episode.
///
/// Slip is what the crosshead says where one pulls, as on the paper's rig: [`labels::slip_interval`] of
/// `displacement_mm`, its encoder. In pulls and twists by hand it is what the interface does, and
/// `displacement_mm` is the way the object has slid over the fingers, in the encoder's steps. The
/// metadata says which as `label_rule`: `encoder` or `interface`.
pub fn generate(recipe: &Recipe) -> Result<Episode, SynthError> {
    let resolved = recipe.resolve()?;
    let (seed, sensors) = (recipe.seed, recipe.sensors);
    let script = script(recipe, &resolved);
    let frames = frames(&script);
    let plan = scenario::plan(&mut stream(seed, Stream::Scenario, 0), &resolved, script);
    let setup = EpisodeSetup::draw(&resolved, &plan, frames);
    let encoder = Encoder::draw(&mut stream(seed, Stream::Encoder, 0));
    let mut log = DrawLog::default();
    log.add("plan", &plan);
    log.add("encoder", &encoder);
    setup.log(&mut log);

    let mut piezo = vec![PiezoFrame::zeroed(); frames * sensors];
    let fingers: Vec<Finger> = (0..sensors).map(|s| setup.finger(s, &mut piezo, &mut log)).collect();
    let (slip_true_mm_s, slip_fraction) = (mean(&fingers, |f| &f.slip_mm_s), mean(&fingers, |f| &f.fraction));
    let displacement_mm = match plan.rule {
        Rule::Encoder => encoder.read(|t| vibration::at(&plan.timeline.crosshead_mm, t), frames),
        Rule::Interface => {
            let slid_mm = mean(&fingers, |f| &f.path_mm);
            let at = |t: f64| slid_mm.get((t * FRAME_HZ) as usize).or(slid_mm.last()).copied();
            encoder.read(|t| f64::from(at(t).unwrap_or(0.0)), frames)
        }
    };
    let slips = slips(&plan, &displacement_mm, &slip_true_mm_s, &slip_fraction);
    let label = labels::label(&piezo, sensors, &slips);
    let mut meta = meta(&resolved, &plan, &setup);
    let faults = fingers.iter().flat_map(|finger| &finger.faults);
    let events: Vec<_> = plan.timeline.events.iter().chain(faults).collect();
    meta.other.insert("events".to_owned(), json!(events));
    meta.other.insert(
        "slip_frames_without_contact".to_owned(),
        labels::slip_without_contact(&label, &slips).into(),
    );
    meta.other.insert("draws".to_owned(), log.into_value());
    Ok(Episode {
        sensors,
        label: Some(label),
        piezo,
        xl_end: (0..frames).flat_map(|f| fingers.iter().map(move |finger| finger.xl_end[f])).collect(),
        slip_true_mm_s: Some(slip_true_mm_s),
        slip_fraction: Some(slip_fraction),
        displacement_mm: Some(displacement_mm),
        meta,
        xl: fingers.into_iter().map(|finger| finger.xl).collect(),
    })
}

/// The accelerometers alone of the episode that [`generate`] makes of a recipe whose vibration content is not `All`: then
/// nothing that touches a pad sounds, and contact is not simulated. Every pad reads 0, and there are no labels.
pub fn generate_accelerometers(recipe: &Recipe) -> Result<Episode, SynthError> {
    let resolved = recipe.resolve()?;
    let script = script(recipe, &resolved);
    let (sensors, frames) = (recipe.sensors, frames(&script));
    let plan = scenario::plan(&mut stream(recipe.seed, Stream::Scenario, 0), &resolved, script);
    let setup = EpisodeSetup::draw(&resolved, &plan, frames);
    let samples = (0..sensors).map(|sensor| setup.accelerometer(sensor, &SlipSeries::default()));
    let (xl, ends): (Vec<_>, Vec<_>) = samples.unzip();
    Ok(Episode {
        sensors,
        label: None,
        piezo: vec![PiezoFrame::zeroed(); frames * sensors],
        xl_end: (0..frames).flat_map(|frame| ends.iter().map(move |end| end[frame])).collect(),
        slip_true_mm_s: None,
        slip_fraction: None,
        displacement_mm: None,
        meta: Meta::nominal(setup.lsb_g),
        xl,
    })
}

/// Frames of slip by the rule of the plan, each pull by itself.
fn slips(plan: &Plan, displacement_mm: &[f32], speed_mm_s: &[f32], fraction: &[f32]) -> Vec<Range<usize>> {
    let last = displacement_mm.len();
    let frame = |t: f64| ((t * FRAME_HZ).max(0.0) as usize).min(last);
    let mut found = Vec::new();
    for &(from, to) in &plan.slips {
        match plan.rule {
            Rule::Encoder => {
                // The encoder's clock may be a frame early, and its stream late.
                let start = frame(from).saturating_sub(2);
                let slip = labels::slip_interval(&displacement_mm[start..frame(to)]);
                found.push(slip.start + start..slip.end + start);
            }
            Rule::Interface => {
                let pull = frame(from)..frame(to);
                found.extend(labels::interface_intervals(speed_mm_s, fraction, pull, labels::GAP_FRAMES));
            }
        }
    }
    found.retain(|slip| !slip.is_empty());
    found
}

/// Generate many episodes on all cores and hand each to `each`, with its position in `recipes`. The
/// results come in the order of the recipes; the first recipe that fails stops the rest.
pub fn generate_set<T: Send>(
    recipes: &[Recipe],
    each: impl Fn(usize, Episode) -> T + Sync,
) -> Result<Vec<T>, SynthError> {
    recipes.par_iter().enumerate().map(|(i, recipe)| Ok(each(i, generate(recipe)?))).collect()
}

fn meta(resolved: &ResolvedRecipe, plan: &Plan, setup: &EpisodeSetup<'_>) -> Meta {
    let recipe = &resolved.recipe;
    let mut meta = Meta::nominal(setup.lsb_g);
    for (key, value) in [
        ("platform", json!(recipe.platform.name())),
        ("synthetic", json!(true)),
        ("source", json!("synthetic, slipsense-synth")),
        ("licence", json!("CC0-1.0")),
        ("object", json!(resolved.object.name)),
        ("object_kind", json!(resolved.object.kind)),
        ("held_out", json!(resolved.object.held_out())),
        ("scenario", json!(resolved.scenario)),
        ("region", json!(recipe.region)),
        ("speed_mm_s", json!(resolved.pulls().then_some(resolved.speed_mm_s))),
        ("grip_n", json!((plan.base_n * 1e3).round() / 1e3)),
        ("units", json!(setup.units)),
        ("rig_leak", json!(recipe.rig_leak)),
        ("label_rule", json!(plan.rule)),
        ("seed", json!(recipe.seed)),
        ("recipe", json!(recipe)),
    ] {
        meta.other.insert(key.to_owned(), value);
    }
    // The rig has one direction, and its recordings are older than this key.
    if plan.hand_held {
        meta.other.insert("slip_direction".to_owned(), json!(plan.slip_direction(resolved)));
    }
    meta
}
