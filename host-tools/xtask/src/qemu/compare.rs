//! Two lists of records, field by field.

use std::fmt::Debug;

use serde::Serialize;
use slipsense_qemu::record::Record;

/// Mismatches described one by one, at most.
const DESCRIBED: usize = 20;

/// Frames in which a part differs.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    pub features: usize,
    pub logits: usize,
    pub class: usize,
    pub slip: usize,
    pub alarm: usize,
    pub health: usize,
    pub can: usize,
    /// Any of the above, or another number of frames.
    pub frames: usize,
}

/// What differs.
#[derive(Clone, Debug, Default)]
pub struct Comparison {
    pub counts: Counts,
    /// CAN frames compared.
    pub can_frames: usize,
    /// Frames whose decision here is slip: what the comparison had to see.
    pub slip_frames: usize,
    /// The first mismatches, in words.
    pub first: Vec<String>,
}

/// Compare what this computer computed with what the emulated one did.
pub fn compare(host: &[Record], emulated: &[Record]) -> Comparison {
    let mut comparison = Comparison::default();
    for (frame, (host, emulated)) in host.iter().zip(emulated).enumerate() {
        comparison.frame(frame, host, emulated);
    }
    comparison.counts.frames += host.len().abs_diff(emulated.len());
    comparison
}

impl Comparison {
    fn frame(&mut self, frame: usize, host: &Record, emulated: &Record) {
        let before = self.counts.clone();
        let mut features = 0;
        for (sensor, (h, e)) in host.log_mel.iter().zip(&emulated.log_mel).enumerate() {
            features += self.values(frame, &format!("ln_power of sensor {sensor}"), &h.ln_power, &e.ln_power);
            features += self.values(
                frame,
                &format!("standardised of sensor {sensor}"),
                &h.standardised,
                &e.standardised,
            );
        }
        let logits = self.values(frame, "logit", &host.logits, &emulated.logits);
        let class = self.values(frame, "class", &[host.class], &[emulated.class]);
        let slip = self.values(frame, "slip flag", &[host.slip], &[emulated.slip]);
        let alarm = self.values(frame, "alarm", &[host.alarm], &[emulated.alarm]);
        let health = self.values(frame, "health", &host.health, &emulated.health);
        let can = self.values(frame, "CAN frame", &host.can, &emulated.can);
        let sequence = self.values(frame, "sequence", &[host.sequence], &[emulated.sequence]);

        self.can_frames += host.can.len();
        self.slip_frames += usize::from(host.slip);
        let counts = &mut self.counts;
        counts.features += usize::from(features > 0);
        counts.logits += usize::from(logits > 0);
        counts.class += usize::from(class > 0);
        counts.slip += usize::from(slip > 0);
        counts.alarm += usize::from(alarm > 0);
        counts.health += usize::from(health > 0);
        counts.can += usize::from(can > 0);
        counts.frames += usize::from(sequence > 0 || *counts != before);
    }

    /// How many values differ; describes the first ones.
    fn values<T: PartialEq + Debug>(
        &mut self,
        frame: usize,
        what: &str,
        host: &[T],
        emulated: &[T],
    ) -> usize {
        let mut differ = host.len().abs_diff(emulated.len());
        if differ > 0 {
            self.describe(format!("frame {frame}: {} {what}s here, {} emulated", host.len(), emulated.len()));
        }
        for (index, (h, e)) in host.iter().zip(emulated).enumerate().filter(|(_, (h, e))| h != e) {
            differ += 1;
            self.describe(format!("frame {frame}: {what} {index} is {h:?} here, {e:?} emulated"));
        }
        differ
    }

    fn describe(&mut self, mismatch: String) {
        if self.first.len() < DESCRIBED {
            self.first.push(mismatch);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slipsense::fixed::Logit;
    use slipsense::wire::CanFrame;

    fn record() -> Record {
        let mut record = Record { logits: [1, 2, 3].map(Logit::from_bits), ..Record::default() };
        record.can.push(CanFrame::new(5, &[1, 2, 3]).unwrap()).unwrap();
        record
    }

    #[test]
    fn equal_records_have_no_mismatch() {
        let comparison = compare(&[record(), record()], &[record(), record()]);
        assert_eq!(comparison.counts, Counts::default());
        assert_eq!(comparison.can_frames, 2);
        assert!(comparison.first.is_empty());
    }

    #[test]
    fn every_part_is_compared() {
        type Change = fn(&mut Record);
        type Count = fn(&mut Counts) -> &mut usize;
        let changes: [(Change, Count); 9] = [
            (|r| r.log_mel[2].ln_power[15] ^= 1, |c| &mut c.features),
            (|r| r.log_mel[0].standardised[0] ^= 1, |c| &mut c.features),
            (|r| r.logits[2] = Logit::from_bits(4), |c| &mut c.logits),
            (|r| r.class = 2, |c| &mut c.class),
            (|r| r.slip = true, |c| &mut c.slip),
            (|r| r.alarm = true, |c| &mut c.alarm),
            (|r| r.health[1] = 1, |c| &mut c.health),
            (|r| r.can[0] = CanFrame::new(5, &[1, 2, 4]).unwrap(), |c| &mut c.can),
            (|r| r.can.clear(), |c| &mut c.can),
        ];
        for (change, count) in changes {
            let mut changed = record();
            change(&mut changed);
            let comparison = compare(&[record(), record()], &[record(), changed]);
            let mut expected = Counts { frames: 1, ..Counts::default() };
            *count(&mut expected) = 1;
            assert_eq!(comparison.counts, expected);
            assert!(comparison.first[0].starts_with("frame 1:"), "{:?}", comparison.first);
        }
    }

    #[test]
    fn a_missing_record_is_a_mismatch() {
        assert_eq!(compare(&[record(), record()], &[record()]).counts.frames, 1);
    }

    #[test]
    fn records_survive_the_output_file() {
        let mut bytes = Vec::new();
        for sequence in 0..3 {
            Record { sequence, ..record() }.encode(|part| bytes.extend_from_slice(part));
        }
        let mut rest = &bytes[..];
        for sequence in 0..3 {
            let decoded = Record::decode(&mut rest).unwrap();
            let comparison = compare(&[Record { sequence, ..record() }], &[decoded]);
            assert_eq!(comparison.counts, Counts::default());
        }
        assert!(rest.is_empty());
        assert!(Record::decode(&mut &bytes[..bytes.len() / 2 - 1]).is_some());
        assert!(Record::decode(&mut &bytes[..40]).is_none(), "a cut record is none");
    }
}
