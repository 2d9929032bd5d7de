//! How much happens: every level, duration and density of the scenarios in one place, so that the world
//! can be made harder or easier without searching for where. Ranges are those of the field: the paper's
//! protocol where it states one, modelling ranges elsewhere.
//!
//! Some of the modelling ranges were tuned. So that frames have the paper's class shares, and neither time
//! nor the crosshead's drive predicts slip: [`IDLE_UNIFORM_S`], [`IDLE_MEAN_S`], [`VARY_S`], [`SETTLE_S`],
//! [`PULL_SHARE_KEPT`], [`REPEAT_CHANCE`], [`REPEAT_LONGEST_S`], [`STROKE_MM`], [`PARKING_TRAVEL`], [`SHARED_TABLE`]. So that the
//! paper's baselines land where they do in the paper: [`RIG_N_PER_MM`], [`AMBIENT_PER_S`],
//! [`TOOL_PICKUP_COUNTS`]; outside this file, the ranges of the arrays' noise and idle level, of the
//! accelerometers' noise and of the flicker of a sliding contact. So that both modalities lead either alone on
//! the other hand, too, with one seed: the tone of its motors at rest, and how far pressure shifts under shear. None was
//! tuned for the shipped network.

use crate::draw::Span;

/// Grip force of one finger, log-normal: median, newtons.
pub(crate) const GRIP_MEDIAN_N: f64 = 2.5;
/// Standard deviation of its logarithm.
pub(crate) const GRIP_SPREAD: f64 = 0.6;
/// Weakest and firmest grip, also after changes, newtons.
pub(crate) const GRIP_N: Span = (0.3, 12.0);
/// Slow variation by the operator: frequency, Hz, and depth of all of it together.
pub(crate) const VARIATION_HZ: Span = (0.1, 4.0);
pub(crate) const VARIATION_DEPTH: Span = (0.1, 0.6);
/// Tremor: frequency, Hz, and depth.
pub(crate) const TREMOR_HZ: Span = (8.0, 12.0);
pub(crate) const TREMOR_DEPTH: Span = (0.01, 0.03);
pub(crate) const SQUEEZE_S: Span = (0.1, 0.5);
/// Rate of a change that stays, shares of the force per second.
pub(crate) const RAMP_PER_S: Span = (0.2, 3.0);
/// Deliberate changes of the grip per second, while the operator varies it and otherwise.
pub(crate) const GRIP_CHANGES_PER_S: Span = (0.9, 0.35);

/// Jaws close on the object, force builds up, force falls, jaws open, seconds.
pub(crate) const CLOSE_S: Span = (0.08, 0.3);
pub(crate) const RISE_S: Span = (0.06, 0.4);
pub(crate) const FALL_S: Span = (0.03, 0.12);
pub(crate) const OPEN_S: Span = (0.05, 0.15);
/// Nothing touches: half of the idles are uniform up to the first bound, the others exponential with the
/// second as their mean and [`IDLE_S`] as bounds.
pub(crate) const IDLE_S: Span = (0.2, 9.0);
pub(crate) const IDLE_UNIFORM_S: f64 = 0.9;
pub(crate) const IDLE_MEAN_S: f64 = 0.4;
/// The operator varies the grip before the pull; the object rests after it, seconds.
pub(crate) const VARY_S: Span = (0.25, 1.8);
pub(crate) const SETTLE_S: Span = (0.1, 0.75);
/// A grasp carried about by hand, and one of a long recording of disturbances, seconds.
pub(crate) const CARRY_S: Span = (1.0, 6.0);
pub(crate) const LONG_HOLD_S: Span = (1.5, 12.0);
/// Length of a recording of disturbances when the recipe leaves it open, seconds.
pub(crate) const DISTURBANCES_S: Span = (20.0, 60.0);
/// Share of a short recording that its pulls may take, of the time that is not jaws in motion.
pub(crate) const PULL_SHARE_KEPT: f64 = 0.55;
/// Share of recordings that hold the protocol twice, if both fit into this many seconds: the longest
/// recordings would else be those of the slowest slips, and their end would predict slip.
pub(crate) const REPEAT_CHANCE: f64 = 0.4;
pub(crate) const REPEAT_LONGEST_S: f64 = 26.0;

/// Crosshead: travel of a slip, mm (less where the object is shorter), and acceleration, mm/s².
pub(crate) const STROKE_MM: Span = (11.0, 25.0);
pub(crate) const ACCEL_MM_S2: Span = (50.0, 500.0);
/// Way between the crosshead's parking place and the object, as a multiple of that travel.
pub(crate) const PARKING_TRAVEL: Span = (1.0, 1.25);
/// Travel of a pull that the grip holds, mm: the gripper's mount gives way.
pub(crate) const FIRM_TRAVEL_MM: Span = (4.0, 20.0);
/// Share of the recordings with a rig that moves for nothing in which the object is linked to it.
pub(crate) const RIG_MOTION_LINKED: f64 = 0.7;
/// Share of the rig recordings whose gripper stands on the rig's own table, where the drive is as loud
/// without the object as through it; otherwise the loud drive alone would mean contact.
pub(crate) const SHARED_TABLE: f64 = 0.95;
/// Compliance of finger, fixture and object in series on the rig, N/mm of each finger.
pub(crate) const RIG_N_PER_MM: Span = (10.0, 250.0);
/// The same for an arm or a hand that pulls or carries.
pub(crate) const HAND_N_PER_MM: Span = (4.0, 40.0);
/// Torsional compliance of a hand that twists, N·mm/rad.
pub(crate) const TWIST_N_MM_PER_RAD: Span = (60.0, 400.0);
/// Travel of a pull by hand, mm, and angle of a twist, rad.
pub(crate) const HAND_TRAVEL_MM: Span = (4.0, 12.0);
pub(crate) const TWIST_RAD: Span = (0.3, 1.2);
/// Share of the hand-held recordings in which the object slips at the end.
pub(crate) const HAND_HELD_SLIPS: f64 = 0.4;
/// Weight of an object as a share of what the weakest grip holds for sure.
pub(crate) const WEIGHT_SHARE: Span = (0.15, 0.5);
/// Friction under a dragged object at full strength, as a share of the same: with the weight it stays below 1.
pub(crate) const DRAG_SHARE: Span = (0.05, 0.4);
/// Pull on a firm grip, as a share of the same.
pub(crate) const FIRM_PULL: Span = (0.2, 0.55);

/// Disturbances per second. Each may come at any time, contact or none, slip or none, unless said
/// otherwise: none of them predicts a class. Disturbance recordings have [`DISTURBANCES_FACTOR`] times as many.
pub(crate) const TAPS_PER_S: f64 = 0.22;
pub(crate) const FOOTFALLS_PER_S: f64 = 0.05;
pub(crate) const AMBIENT_PER_S: f64 = 0.2;
/// Trigger play or motor actuation, outside closing and opening.
pub(crate) const JAW_PER_S: f64 = 0.12;
/// The object re-orients in the grip; only while held, never while pulled.
pub(crate) const ROLLING_PER_S: f64 = 0.15;
/// The held object is dragged over something; never where it is linked to the rig.
pub(crate) const DRAGS_PER_S: f64 = 0.15;
/// Swings of the carrying hand; only where a hand or an arm carries.
pub(crate) const MOTIONS_PER_S: f64 = 0.3;
pub(crate) const DISTURBANCES_FACTOR: f64 = 2.0;

/// Duration and peak of taps on object, finger or table, seconds and g.
pub(crate) const TAP_S: Span = (0.2e-3, 8e-3);
pub(crate) const TAP_G: Span = (0.05, 5.0);
/// Share of the taps that come as trains.
pub(crate) const TAP_TRAIN_CHANCE: f64 = 0.35;
/// Jaws against their end stop or each other: peak, g, and width, seconds.
pub(crate) const END_STOP_G: Span = (0.05, 0.8);
pub(crate) const END_STOP_S: Span = (0.5e-3, 4e-3);
/// How long the aftershock of an opening counts as part of it, seconds.
pub(crate) const AFTERSHOCK_S: f64 = 0.3;
/// Footfalls near the rig's table: peak, g, and width, seconds.
pub(crate) const FOOTFALL_G: Span = (0.01, 0.3);
pub(crate) const FOOTFALL_S: Span = (5e-3, 40e-3);
/// Speed at which a gripped object is dragged over something at full strength, mm/s.
pub(crate) const DRAG_MM_S: f64 = 40.0;
/// Slope by which an object rolls in the grip, rad.
pub(crate) const ROLL_RAD: Span = (1e-3, 10e-3);
/// Interference of running motors in the arrays, counts rms: motorised hand, hand-driven jaw.
pub(crate) const MOTOR_PICKUP_COUNTS: Span = (0.02, 0.3);
pub(crate) const JAW_PICKUP_COUNTS: f64 = 0.02;
/// The same of a tool that runs nearby, at its loudest.
pub(crate) const TOOL_PICKUP_COUNTS: f64 = 1.2;
