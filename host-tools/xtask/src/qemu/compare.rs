//! Two lists of records, part by part.

use std::fmt::Debug;

use slipsense_qemu::record::Record;

/// Mismatches described one by one, at most.
const DESCRIBED: usize = 20;

#[derive(Debug, Default)]
pub struct Comparison {
    /// Frames in which a part differs, in the order of [`parts`].
    pub by_part: [usize; PARTS.len()],
    /// Frames in which any part differs, and missing ones.
    pub frames: usize,
    pub can_frames: usize,
    /// Frames whose decision here is slip: what the comparison had to see.
    pub slip_frames: usize,
    /// The first mismatches, in words.
    pub first: Vec<String>,
}

pub const PARTS: [&str; 8] =
    ["features", "logits", "class", "may begin", "slip", "health", "CAN", "sequence"];

/// The values of each part, with what they are, as text.
fn parts(record: &Record) -> [Vec<String>; PARTS.len()] {
    fn named(name: &str, values: impl IntoIterator<Item: Debug>) -> Vec<String> {
        let values = values.into_iter().enumerate();
        values.map(|(index, value)| format!("{name} {index} is {value:?}")).collect()
    }
    let features = record.log_mel.iter().enumerate().flat_map(|(sensor, log_mel)| {
        let mut values = named(&format!("sensor {sensor}, ln_power"), log_mel.ln_power);
        values.extend(named(&format!("sensor {sensor}, standardised"), log_mel.standardised));
        values.extend(named(&format!("sensor {sensor}, over the floor"), log_mel.over_floor));
        values
    });
    [
        features.collect(),
        named("logit", record.logits),
        named("class", [record.class]),
        named("may begin", [record.may_begin]),
        named("slip flag", [record.slip]),
        named("health", record.health),
        named("CAN frame", &record.can),
        named("sequence", [record.sequence]),
    ]
}

pub fn compare(host: &[Record], emulated: &[Record]) -> Comparison {
    let mut comparison = Comparison { frames: host.len().abs_diff(emulated.len()), ..Comparison::default() };
    for (frame, (host, emulated)) in host.iter().zip(emulated).enumerate() {
        comparison.can_frames += host.can.len();
        comparison.slip_frames += usize::from(host.may_begin);
        let mut differs = false;
        for (part, (here, there)) in parts(host).iter().zip(&parts(emulated)).enumerate() {
            if here == there {
                continue;
            }
            differs = true;
            comparison.by_part[part] += 1;
            let name = PARTS[part];
            if here.len() != there.len() {
                let [here, there] = [here.len(), there.len()];
                comparison.describe(format!("frame {frame}, {name}: {here} here, {there} emulated"));
            }
            for (here, there) in here.iter().zip(there).filter(|(here, there)| here != there) {
                comparison.describe(format!("frame {frame}: {here} here; {there} emulated"));
            }
        }
        comparison.frames += usize::from(differs);
    }
    comparison
}

impl Comparison {
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
    fn equal_records_have_no_mismatch_and_a_missing_one_is_one() {
        let comparison = compare(&[record(), record()], &[record(), record()]);
        assert_eq!((comparison.frames, comparison.by_part), (0, [0; PARTS.len()]));
        assert_eq!(comparison.can_frames, 2);
        assert!(comparison.first.is_empty());
        assert_eq!(compare(&[record(), record()], &[record()]).frames, 1);
    }

    #[test]
    fn every_part_is_compared() {
        type Change = fn(&mut Record);
        let changes: [(Change, &str); 11] = [
            (|r| r.log_mel[2].ln_power[15] ^= 1, "features"),
            (|r| r.log_mel[0].standardised[0] ^= 1, "features"),
            (|r| r.log_mel[1].over_floor[3] ^= 1, "features"),
            (|r| r.logits[2] = Logit::from_bits(4), "logits"),
            (|r| r.class = 2, "class"),
            (|r| r.may_begin = true, "may begin"),
            (|r| r.slip = true, "slip"),
            (|r| r.health[1] = 1, "health"),
            (|r| r.can[0] = CanFrame::new(5, &[1, 2, 4]).unwrap(), "CAN"),
            (|r| r.can.clear(), "CAN"),
            (|r| r.sequence = 1, "sequence"),
        ];
        for (change, part) in changes {
            let mut changed = record();
            change(&mut changed);
            let comparison = compare(&[record(), record()], &[record(), changed]);
            assert_eq!(comparison.frames, 1);
            assert_eq!(comparison.by_part, PARTS.map(|name| usize::from(name == part)), "{part}");
            assert!(comparison.first[0].starts_with("frame 1"), "{:?}", comparison.first);
        }
    }
}
