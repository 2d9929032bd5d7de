//! What is known of a module from its traffic.

use slipsense::health::TAXELS_MASKED;
use slipsense::params::{MAX_SENSORS, TAXEL_ROWS};
use slipsense::sensor::TaxelMask;
use slipsense::wire::{DEGRADED_NOT_CALIBRATED, SlipMessage};
use slipsense_recording::decode::Heartbeat;

/// What is known of one module.
#[derive(Default)]
pub struct Module {
    pub heartbeat: Option<Heartbeat>,
    pub slip: Option<SlipMessage>,
    pub sensors: [Sensor; MAX_SENSORS],
    /// Since the last diagnostics.
    pub second: Second,
    info: Option<(u16, Vec<(String, i16)>)>,
}

#[derive(Default)]
pub struct Sensor {
    /// As the module says: times calibrated and name, or `none`.
    pub calibration: Option<String>,
    /// As somebody read it from the module.
    pub mask: Option<TaxelMask>,
    is_masked: bool,
}

#[derive(Default)]
pub struct Second {
    pub slip_messages: u32,
    pub invalid: u8,
    pub degraded: u8,
    pub health: [u8; MAX_SENSORS],
    pub raw_messages: [u32; MAX_SENSORS],
}

impl Module {
    pub fn is_calibrated(&self, sensor: usize) -> bool {
        let all_are = self.slip.as_ref().is_some_and(|slip| slip.degraded & DEGRADED_NOT_CALIBRATED == 0);
        all_are || self.sensors[sensor].calibration.as_ref().is_some_and(|name| name != "none")
    }

    /// Taxels to leave out of the pressure. `None`: there are some, and nobody has read which.
    pub fn mask(&self, sensor: usize) -> Option<TaxelMask> {
        let Sensor { mask, is_masked, .. } = &self.sensors[sensor];
        // An empty one was read before the first taxel was left out.
        mask.filter(|mask| !is_masked || !mask.is_empty()).or((!is_masked).then_some(TaxelMask::NONE))
    }

    pub fn accept(&mut self, message: &SlipMessage) {
        self.second.slip_messages += 1;
        self.second.invalid |= message.invalid;
        self.second.degraded |= message.degraded;
        for (sensor, contact) in message.contact.iter().take(message.sensors.into()).enumerate() {
            self.second.health[sensor] |= contact.health;
            self.sensors[sensor].is_masked = contact.health & TAXELS_MASKED != 0;
        }
        let last = self.slip.replace(*message);
        if last.is_some_and(|last| last.configuration != message.configuration) {
            self.sensors.iter_mut().for_each(|sensor| sensor.mask = None);
        }
    }

    /// What a subscriber may want to know once, if it has changed.
    pub fn news(&mut self) -> Option<(u16, Vec<(String, i16)>)> {
        let slip = self.slip.as_ref()?;
        let of_sensor = |(sensor, known): (usize, &Sensor)| {
            let masked = self.mask(sensor).map_or(-1, |mask| mask.len() as i16);
            (known.calibration.clone().unwrap_or_default(), masked)
        };
        let sensors = self.sensors.iter().enumerate().take(slip.sensors.into()).map(of_sensor).collect();
        let info = Some((slip.configuration, sensors));
        if self.info == info {
            return None;
        }
        self.info = info;
        self.info.clone()
    }
}

/// The register that has the taxels that a sensor's array leaves out, masked, faulty or stuck.
pub fn mask_register(sensor: usize) -> String {
    format!("slipsense.sensor.{sensor}.stuck")
}

pub fn mask_of(register: &str, rows: &[u64]) -> Option<(usize, TaxelMask)> {
    let sensor = (0..MAX_SENSORS).find(|&sensor| mask_register(sensor) == register)?;
    let rows: [u64; TAXEL_ROWS] = rows.try_into().ok()?;
    Some((sensor, TaxelMask(rows.map(|row| row as u32))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_is_known_as_long_as_it_can_be_the_modules() {
        let mut module = Module::default();
        let said = |module: &mut Module, configuration, health| {
            let mut message = SlipMessage { sensors: 1, configuration, ..SlipMessage::default() };
            message.contact[0].health = health;
            module.accept(&message);
            module.mask(0).map(|mask| mask.len())
        };
        assert_eq!(said(&mut module, 1, 0), Some(0));
        module.sensors[0].mask = Some(TaxelMask::NONE);
        assert_eq!(said(&mut module, 1, TAXELS_MASKED), None, "it was read before");
        module.sensors[0].mask = Some(TaxelMask([1; TAXEL_ROWS]));
        let known = said(&mut module, 1, TAXELS_MASKED);
        assert!(known.is_some_and(|taxels| taxels > 0));
        assert_eq!(said(&mut module, 2, TAXELS_MASKED), None, "of another configuration");
    }
}
