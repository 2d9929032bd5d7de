//! Families of physics: every stage of the world in several forms, so that what a detector has learned of one form can
//! be judged on another. What forms of a stage still share is in `docs/src/evaluation/world.md`.
//!
//! The first family of each stage is the laboratory's, of the paper's protocol; training never sees the one held out.

use serde::{Deserialize, Serialize};

use crate::draw::{Draw, Rng};

/// Families of every stage.
pub const FAMILIES: usize = 4;

pub trait Family: Copy + PartialEq + 'static {
    /// All of them: the laboratory's first, the one that training never sees last.
    const ALL: [Self; FAMILIES];
}

fn any<F: Family>(rng: &mut Rng) -> F {
    F::ALL[rng.count(0, FAMILIES - 2)]
}

macro_rules! family {
    ($(#[$doc:meta])* $stage:ident { $($(#[$attribute:meta])* $name:ident,)* }
     held out: $(#[$held_doc:meta])* $held:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum $stage {
            $($(#[$attribute])* $name,)*
            $(#[$held_doc])* $held,
        }

        impl Family for $stage {
            const ALL: [Self; FAMILIES] = [$(Self::$name,)* Self::$held];
        }

        impl Default for $stage {
            fn default() -> Self {
                Self::ALL[0]
            }
        }
    };
}

family! {
    /// How the object presses.
    ContactFamily {
        /// An elastic layer on a stiff backing, indented by the object's face.
        Foundation,
        /// A soft object wraps around the finger: a smooth plateau that grows with the force.
        Conforming,
        /// Separate summits of a rough face bear the load, more of them as it grows.
        Summits,
    }
    held out:
        /// An elastic half-space: ellipses under round things, pressed edges under flat ones.
        HalfSpace
}

family! {
    /// How the object sticks and slides.
    FrictionFamily {
        /// A brush of bristles with Coulomb caps: slip spreads from the rim.
        Brush,
        /// One elastic bristle with memory for the whole patch (LuGre).
        Bristle,
        /// A mass on a spring with static and kinetic friction: stick-slip comes from the dynamics.
        Mass,
    }
    held out:
        /// Friction by rate and state (Dieterich): sliding begins as creep.
        RateState
}

family! {
    /// How the film answers to pressure; behind each stands the simulated front end.
    FilmFamily {
        /// Play hysteresis and creep by decades, a power law.
        Plays,
        /// One power law while the load rises, a flatter one from its peak on.
        Branches,
        /// A part that follows at once and two that relax, slower in release; gain fluctuates.
        Relaxing,
    }
    held out:
        /// A threshold, then the logarithm of pressure; a threshold that a load has moved.
        Percolating
}

family! {
    /// What makes the vibration of slip.
    SourceFamily {
        /// Filtered noise whose corner rises with speed, texture lines and stick-slip pulses.
        #[serde(rename = "modal")]
        Asperities,
        /// Two tracks over one height profile, read at the slid length.
        Profile,
        /// Single impulses at random slid lengths.
        Grains,
    }
    held out:
        /// Autoregressive noise by speed and force, stated at the accelerometer.
        Autoregressive
}

family! {
    /// The way of a vibration to the accelerometer.
    PathFamily {
        /// Four modes of a finger of the laboratory.
        Modes,
        /// Three to nine modes of any finger, at any frequency.
        FreeModes,
        /// Random sections in series, with cross-talk between axes.
        Sections,
    }
    held out:
        /// Decaying random echoes of each axis.
        Echoes
}

family! {
    /// What disturbs beside the scenario's own handling.
    DisturbanceFamily {
        /// Nothing else.
        Handling,
        /// Knocks, steps and shakes with their own ringing.
        Knocks,
        /// A machine or a motor with harmonics that swell and change their speed.
        Tools,
    }
    held out:
        /// Cloth, cables and other fingers rub where no pad is.
        Rubbing
}

family! {
    /// What the accelerometer makes of it.
    SensorFamily {
        /// A laboratory's part: white noise, offset, wander.
        Part,
        /// Noise that rises to low frequencies; a low corner; strong cross-axis terms.
        Flicker,
        /// A resonance inside the band; a small range that clips.
        Resonant,
    }
    held out:
        /// Gain that fades, ticks of a loose contact, coarse steps.
        Worn
}

/// Which family makes each stage of an episode, but for the source of its slip vibration, which is the recipe's own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Families {
    pub contact: ContactFamily,
    pub friction: FrictionFamily,
    pub film: FilmFamily,
    pub path: PathFamily,
    pub disturbance: DisturbanceFamily,
    pub sensor: SensorFamily,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    Contact,
    Friction,
    Film,
    Source,
    Path,
    Disturbance,
    Sensor,
}

impl Stage {
    pub const ALL: [Self; 7] = {
        use Stage::*;
        [Contact, Friction, Film, Source, Path, Disturbance, Sensor]
    };
}

impl Families {
    pub fn is_laboratory(&self) -> bool {
        *self == Self::default()
    }

    /// Any that training may see.
    pub(crate) fn draw(rng: &mut Rng) -> (Self, SourceFamily) {
        let families = Self {
            contact: any(rng),
            friction: any(rng),
            film: any(rng),
            path: any(rng),
            disturbance: any(rng),
            sensor: any(rng),
        };
        (families, any(rng))
    }
}
