//! The C header, compiled by the C compiler of this computer, against our decoder.

use std::fs;
use std::process::Command;

use slipsense::fixed::Q;
use slipsense::wire::{NodeId, SensorContact, SlipMessage, Transmitter};

const PROGRAM: &str = r#"
#include "slip.h"
#include <stdio.h>

int main(void) {
    uint8_t data[64];
    if (fread(data, 1, sizeof data, stdin) != sizeof data) return 9;
    slipsense_slip_t m;
    int result = slipsense_slip_decode(data, sizeof data, &m);
    if (result != 0 || slipsense_slip_decode(data, 63, &m) != -1) return -result + 10;
    printf("%lx %llu %u %u %d %u %d %u %d %d %d", (unsigned long)SLIPSENSE_SLIP_CAN_ID(SLIPSENSE_NODE_DEFAULT),
        (unsigned long long)m.timestamp_us, (unsigned)m.sequence, m.class_index, m.slip, m.sensors, m.alarm,
        m.late_frames, (int)m.logits_q10[0], (int)m.logits_q10[1], (int)m.logits_q10[2]);
    for (int i = 0; i < 3; i++) {
        slipsense_contact_t c = m.contact[i];
        printf(" %u %u %u %u %u %d %u", c.health, (unsigned)c.count_sum, c.area, c.centroid_row_q8,
            c.centroid_col_q8, c.axis_deg, c.elongation_q8);
    }
    return 0;
}
"#;

fn words(message: &SlipMessage, id: u32) -> String {
    let m = message;
    let mut words = format!(
        "{id:x} {} {} {} {} {} {} {} {} {} {}",
        m.timestamp_us,
        m.sequence,
        m.class,
        u8::from(m.slip),
        m.sensors,
        u8::from(m.alarm),
        m.late_frames,
        m.logits[0].to_bits(),
        m.logits[1].to_bits(),
        m.logits[2].to_bits()
    );
    for c in m.contact {
        words += &format!(
            " {} {} {} {} {} {} {}",
            c.health,
            c.sum,
            c.area,
            c.centroid_row.to_bits(),
            c.centroid_col.to_bits(),
            c.axis_deg,
            c.elongation.to_bits()
        );
    }
    words
}

#[test]
fn c_reads_what_we_send() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("slip.h"), slipsense_recording::c_header::text().unwrap()).unwrap();
    fs::write(dir.path().join("main.c"), PROGRAM).unwrap();
    let program = dir.path().join("decode");
    let compiled = Command::new("cc")
        .args(["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-O2", "-o"])
        .arg(&program)
        .arg(dir.path().join("main.c"))
        .output()
        .expect("cc is there: Rust links with it");
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));

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
        alarm: true,
        logits: [i32::MIN, -1, 0x1234_5678].map(Q::from_bits),
        late_frames: 0xABCD,
        sensors: 3,
        contact: [contact(0), contact(1), contact(2)],
    };
    for message in [full, SlipMessage::default(), SlipMessage { class: 1, sensors: 1, ..full }] {
        let frame = Transmitter::new(NodeId::DEFAULT).slip(&message);
        let (code, said) = run(&program, frame.data());
        assert_eq!((code, said), (Some(0), words(&message, frame.id())));
    }
    // A class without a meaning, and the first frame of a longer transfer.
    let mut data = Transmitter::new(NodeId::DEFAULT).slip(&full).data().to_vec();
    data[11] |= 3;
    assert_eq!(run(&program, &data).0, Some(13));
    data[63] &= 0x9F;
    assert_eq!(run(&program, &data).0, Some(12));
}

fn run(program: &std::path::Path, data: &[u8]) -> (Option<i32>, String) {
    let input = tempfile::NamedTempFile::new().unwrap();
    fs::write(input.path(), data).unwrap();
    let output = Command::new(program).stdin(fs::File::open(input.path()).unwrap()).output().unwrap();
    (output.status.code(), String::from_utf8(output.stdout).unwrap())
}
