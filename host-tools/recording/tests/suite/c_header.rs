//! The C header, compiled by the C compiler of this computer, against our decoder.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use slipsense::fixed::Q;
use slipsense::wire::{NodeId, SensorContact, SlipMessage, Transmitter};

/// `decode`: a frame of the default node on the standard input, as words. Else records of time and frame into a receiver,
/// what came of each out of it.
const PROGRAM: &str = r#"
#include "slip.h"
#include <stdio.h>
#include <string.h>

static int words(void) {
    uint8_t data[64];
    if (fread(data, 1, sizeof data, stdin) != sizeof data) return 9;
    slipsense_slip_t m;
    int result = slipsense_slip_decode(SLIPSENSE_NODE_DEFAULT, data, sizeof data, &m);
    if (result != 0 || slipsense_slip_decode(SLIPSENSE_NODE_DEFAULT, data, 63, &m) != -1) return -result + 10;
    printf("%lx %llu %u %u %d %d %u %d %u %u %u %u %u %d %d %d %d", (unsigned long)SLIPSENSE_SLIP_CAN_ID(SLIPSENSE_NODE_DEFAULT),
        (unsigned long long)m.timestamp_us, (unsigned)m.sequence, m.class_index, m.slip, m.may_begin, m.sensors, m.locked,
        m.invalid, m.degraded, m.starts, m.configuration, m.late_frames, (int)m.logits_q8[0], (int)m.logits_q8[1],
        (int)m.logits_q8[2], (int)m.log_odds_q8);
    for (int i = 0; i < 3; i++) {
        slipsense_contact_t c = m.contact[i];
        printf(" %u %u %u %u %u %d %u", c.health, (unsigned)c.count_sum, c.area, c.centroid_row_q8,
            c.centroid_col_q8, c.axis_deg, c.elongation_q8);
    }
    return 0;
}

int main(int count, char **arguments) {
    (void)arguments;
    if (count > 1) return words();
    slipsense_receiver_t receiver = {.node = SLIPSENSE_NODE_DEFAULT};
    uint8_t record[73];
    while (fread(record, 1, sizeof record, stdin) == sizeof record) {
        uint64_t now = 0;
        for (int i = 7; i >= 0; i--) now = now << 8 | record[i];
        uint8_t out[7];
        out[0] = (uint8_t)slipsense_receive(&receiver, record + 9, record[8], now);
        out[1] = (uint8_t)slipsense_state(&receiver, now);
        out[2] = out[1] == SLIPSENSE_VALID && receiver.message.slip;
        for (int i = 0; i < 4; i++) out[3 + i] = (uint8_t)(receiver.lost >> 8 * i);
        fwrite(out, 1, sizeof out, stdout);
        fflush(stdout);
    }
    return 0;
}
"#;

fn words(message: &SlipMessage, id: u32) -> String {
    let m = message;
    let mut words = vec![format!("{id:x}")];
    let logits = m.logits.map(|logit| i64::from(logit.to_bits()));
    let fields =
        [m.timestamp_us as i64, m.sequence.into(), m.class.into(), m.slip.into(), m.may_begin.into()];
    let node = [m.sensors.into(), m.locked.into(), m.invalid.into(), m.degraded.into(), m.starts.into()];
    let rest = [m.configuration.into(), m.late_frames.into(), logits[0], logits[1], logits[2]];
    words.extend([fields, node, rest].concat().iter().map(i64::to_string));
    words.push(m.log_odds.to_bits().to_string());
    for c in m.contact {
        let [row, col] = [c.centroid_row, c.centroid_col].map(|centre| centre.to_bits());
        let elongation = c.elongation.to_bits();
        words.push(format!("{} {} {} {row} {col} {} {elongation}", c.health, c.sum, c.area, c.axis_deg));
    }
    words.join(" ")
}

pub fn compile(folder: &Path) -> PathBuf {
    fs::write(folder.join("slip.h"), slipsense_recording::c_header::text().unwrap()).unwrap();
    fs::write(folder.join("main.c"), PROGRAM).unwrap();
    let program = folder.join("receiver");
    let compiled = Command::new("cc")
        .args(["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-O2", "-o"])
        .arg(&program)
        .arg(folder.join("main.c"))
        .output()
        .expect("cc is there: Rust links with it");
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    program
}

#[test]
fn c_reads_what_we_send() {
    let dir = tempfile::tempdir().unwrap();
    let program = compile(dir.path());
    let contact = |i: u16| SensorContact {
        health: 0x81 + i as u8,
        sum: 3_857_490 - u32::from(i),
        area: 942 - i,
        centroid_row: Q::from_bits(0x1EFF - i),
        centroid_col: Q::from_bits(0x0102 + i),
        axis_deg: -90 + i as i8,
        elongation: Q::from_bits(250 + i as u8),
    };
    let full = SlipMessage {
        timestamp_us: 0x00FE_DCBA_9876_5432,
        sequence: 0xFEDC_BA98,
        class: 2,
        slip: true,
        may_begin: true,
        sensors: 3,
        locked: true,
        invalid: 0x81,
        degraded: 0x7E,
        starts: 0xFE,
        configuration: 0xABCD,
        late_frames: 0xFF,
        logits: [i16::MIN, -1, 0x1234].map(Q::from_bits),
        log_odds: Q::from_bits(-2),
        contact: [contact(0), contact(1), contact(2)],
    };
    for message in [full, SlipMessage::default(), SlipMessage { class: 1, sensors: 1, ..full }] {
        let frame = Transmitter::new(NodeId::DEFAULT).slip(&message);
        let (code, said) = run(&program, frame.data());
        assert_eq!((code, said), (Some(0), words(&message, frame.id())));
    }
    // A flipped bit, a class without a meaning, the first frame of a longer transfer.
    let mut data = Transmitter::new(NodeId::DEFAULT).slip(&full).data().to_vec();
    data[20] ^= 1;
    assert_eq!(run(&program, &data).0, Some(14));
    data[11] |= 3;
    assert_eq!(run(&program, &data).0, Some(13));
    data[63] &= 0x9F;
    assert_eq!(run(&program, &data).0, Some(12));
}

fn run(program: &Path, data: &[u8]) -> (Option<i32>, String) {
    let input = tempfile::NamedTempFile::new().unwrap();
    fs::write(input.path(), data).unwrap();
    let output =
        Command::new(program).arg("decode").stdin(fs::File::open(input.path()).unwrap()).output().unwrap();
    (output.status.code(), String::from_utf8(output.stdout).unwrap())
}
