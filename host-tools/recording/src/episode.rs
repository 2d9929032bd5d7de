//! The episode itself: what an array of frames and a stream of samples mean together.

use crate::{Meta, Problem};
use slipsense::params::{MAX_SENSORS, XL_BATCH_MAX};
use slipsense::sensor::{PiezoFrame, SensorInput, SensorReadings, XlSample};

/// One stretch of sensor data, with labels where someone knows them.
///
/// Fields are public so that generators can fill them; [`Episode::validate`] checks the rules, and
/// [`Episode::write`] does so before it writes. [`Episode::read`] hands out only what follows the rules.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Episode {
    /// Sensors, 1 to 3.
    pub sensors: usize,
    /// Array scans, `[frame * sensors + sensor]`.
    pub piezo: Vec<PiezoFrame>,
    /// Accelerometer samples, `[sensor][sample]`, all sensors the same number.
    pub xl: Vec<Vec<XlSample>>,
    /// Samples of `xl[sensor]` available at the frame tick (exclusive end), `[frame * sensors + sensor]`.
    pub xl_end: Vec<u32>,
    /// 0 no contact, 1 no slip, 2 slip, by the encoder rule; one per frame.
    pub label: Option<Vec<u8>>,
    /// Interface slip speed, mm/s, at least 0 (simulator truth); one per frame. Array `slip_true`.
    pub slip_true_mm_s: Option<Vec<f32>>,
    /// Share of the load that slips, 0–1 (simulator truth); one per frame.
    pub slip_fraction: Option<Vec<f32>>,
    /// Crosshead encoder, mm; one per frame.
    pub displacement_mm: Option<Vec<f32>>,
    /// Units, rates, origin.
    pub meta: Meta,
}

impl Episode {
    /// Number of frames; 0 where there is no sensor.
    pub fn frames(&self) -> usize {
        self.piezo.len().checked_div(self.sensors).unwrap_or(0)
    }

    /// The scan of one sensor in one frame.
    ///
    /// # Panics
    /// Where `frame` or `sensor` is not in the episode, as the other accessors do.
    pub fn piezo(&self, frame: usize, sensor: usize) -> &PiezoFrame {
        &self.piezo[self.at(frame, sensor)]
    }

    /// Samples of `xl[sensor]` available at the tick of this frame, exclusive end.
    pub fn xl_end(&self, frame: usize, sensor: usize) -> u32 {
        self.xl_end[self.at(frame, sensor)]
    }

    /// The samples that arrived since the previous tick (for frame 0: since the start), oldest first.
    pub fn xl_batch(&self, frame: usize, sensor: usize) -> &[XlSample] {
        let start = if frame == 0 { 0 } else { self.xl_end(frame - 1, sensor) };
        &self.xl[sensor][start as usize..self.xl_end(frame, sensor) as usize]
    }

    /// What one sensor delivered for one frame, as a board hands it to its tasks. An error where that is more than a
    /// board takes: [`XL_BATCH_MAX`] samples.
    pub fn sensed(&self, frame: usize, sensor: usize) -> Result<SensorReadings, Problem> {
        let (mut part, batch) = (SensorReadings::new(), self.xl_batch(frame, sensor));
        let Ok(()) = part.xl.extend_from_slice(batch) else {
            let rule = format!("{} samples in one frame, a board takes {XL_BATCH_MAX}", batch.len());
            return Err(Problem::element("xl_end", &[frame, sensor], self.xl_end(frame, sensor), rule));
        };
        part.piezo = self.piezo(frame, sensor).clone();
        (part.piezo_arrived, part.xl_arrived, part.xl_end) = (true, true, self.xl_end(frame, sensor));
        Ok(part)
    }

    /// What each sensor delivered for one frame; entries beyond the episode's sensors are empty.
    pub fn inputs(&self, frame: usize) -> [SensorInput<'_>; MAX_SENSORS] {
        std::array::from_fn(|sensor| match sensor < self.sensors {
            true => SensorInput {
                piezo: Some(self.piezo(frame, sensor)),
                xl: Some(self.xl_batch(frame, sensor)),
                xl_end: self.xl_end(frame, sensor),
            },
            false => SensorInput::default(),
        })
    }

    fn at(&self, frame: usize, sensor: usize) -> usize {
        assert!(sensor < self.sensors, "sensor {sensor} of {}", self.sensors);
        frame * self.sensors + sensor
    }

    /// Check every rule of the format that the types do not enforce. The counts are not among them:
    /// a [`PiezoFrame`] cannot hold a wrong one.
    pub fn validate(&self) -> Result<(), Problem> {
        self.validate_beside(self.piezo.len())
    }

    /// The same without the scans, of which there are `scans`.
    pub(crate) fn validate_beside(&self, scans: usize) -> Result<(), Problem> {
        self.meta.validate()?;
        self.validate_lengths(scans)?;
        self.validate_xl_end()?;
        let frames = 0..scans / self.sensors;
        if let Some(label) = &self.label
            && let Some(f) = frames.clone().find(|&f| label[f] > 2)
        {
            return Err(Problem::element("label", &[f], label[f], "must be 0, 1 or 2"));
        }
        type Rule = (fn(f32) -> bool, &'static str);
        let not_negative: Rule = (|v| v.is_finite() && v >= 0.0, "must be finite and not negative");
        let share: Rule = ((|v| (0.0..=1.0).contains(&v)), "must be from 0 to 1");
        let finite: Rule = (f32::is_finite, "must be finite");
        for ((array, values), (is_right, rule)) in
            self.float_arrays().into_iter().zip([not_negative, share, finite])
        {
            if let Some(values) = values
                && let Some(f) = frames.clone().find(|&f| !is_right(values[f]))
            {
                return Err(Problem::element(array, &[f], values[f], rule));
            }
        }
        Ok(())
    }

    /// The optional float arrays under the names they have in a file.
    pub(crate) fn float_arrays(&self) -> [(&'static str, Option<&[f32]>); 3] {
        [
            ("slip_true", self.slip_true_mm_s.as_deref()),
            ("slip_fraction", self.slip_fraction.as_deref()),
            ("displacement_mm", self.displacement_mm.as_deref()),
        ]
    }

    fn validate_lengths(&self, scans: usize) -> Result<(), Problem> {
        let sensors = self.sensors;
        let refuse = |array, rule: String| Err(Problem::array(array, rule));
        if !(1..=MAX_SENSORS).contains(&sensors) {
            return refuse("piezo", format!("holds {sensors} sensors, must be 1 to {MAX_SENSORS}"));
        }
        if scans == 0 {
            return refuse("piezo", "holds no frame, must hold at least one".to_owned());
        }
        if !scans.is_multiple_of(sensors) {
            return refuse("piezo", format!("{scans} scans are not a multiple of {sensors} sensors"));
        }
        if self.xl.len() != sensors {
            return refuse("xl", format!("holds {} sensors, must be {sensors}", self.xl.len()));
        }
        let samples = self.xl[0].len();
        if let Some(s) = self.xl.iter().position(|xl| xl.len() != samples) {
            let rule = format!("sensor {s} has {} samples, must be {samples} as sensor 0", self.xl[s].len());
            return refuse("xl", rule);
        }
        let frames = scans / sensors;
        let of_frames = |array, len, must| match len == must {
            true => Ok(()),
            false => refuse(array, format!("holds {len} values, must be {must} for {frames} frames")),
        };
        of_frames("xl_end", self.xl_end.len(), frames * sensors)?;
        of_frames("label", self.label.as_ref().map_or(frames, Vec::len), frames)?;
        for (array, values) in self.float_arrays() {
            of_frames(array, values.map_or(frames, <[f32]>::len), frames)?;
        }
        Ok(())
    }

    fn validate_xl_end(&self) -> Result<(), Problem> {
        for (i, &end) in self.xl_end.iter().enumerate() {
            let (frame, sensor) = (i / self.sensors, i % self.sensors);
            let samples = self.xl[sensor].len();
            let previous = if frame == 0 { 0 } else { self.xl_end(frame - 1, sensor) };
            let rule = if end < previous {
                format!("must not decrease, the frame before has {previous}")
            } else if end as usize > samples {
                format!("must be at most N = {samples}")
            } else {
                continue;
            };
            return Err(Problem::element("xl_end", &[frame, sensor], end, rule));
        }
        Ok(())
    }
}
