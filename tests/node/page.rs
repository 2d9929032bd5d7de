//! The page of registers is what the table says.

use std::fmt::Write;

use slipsense::node::{
    BEGIN_MODEL_UPDATE, BEGIN_SOFTWARE_UPDATE, CALIBRATE, FACTORY_RESET, SCALE_GAIN, STORE, UNLOCK,
};
use slipsense::settings::{Effect, TABLE};

/// `docs/src/bus/settings.md`, from the table.
fn page() -> String {
    let mut page = String::from(
        "# Settings\n\nEvery setting is a register of the Cyphal node, mutable and persistent. `store` (ExecuteCommand \
         65530) writes all of them to\nflash; a factory reset (65532) restores the defaults and keeps the calibrations. The node \
         accepts one store or factory reset\nevery ten seconds. For each register NAME, the registers NAME`<`, NAME`>` and NAME`=` \
         hold the largest, smallest and default\nvalue. This page is generated from `src/settings/table.rs`; a test compares.\n\n\
         | register | type | default | allowed | unit | effective | meaning |\n|---|---|---|---|---|---|---|\n",
    );
    for definition in &TABLE {
        let count = definition.default.len();
        let kind = format!("{:?}", definition.kind).to_lowercase();
        let all_zero = count > 3 && definition.default.iter().all(|&element| element == 0);
        let default = match all_zero {
            true => "0".to_owned(),
            false => definition.default.iter().map(i64::to_string).collect::<Vec<_>>().join(", "),
        };
        let mut allowed: Vec<String> =
            (0..count.min(3)).map(|element| definition.rule(element).to_string()).collect();
        allowed.dedup();
        let mut allowed = allowed.join("; ");
        if let Some((_, together)) = definition.together {
            write!(allowed, "; {together}").unwrap();
        }
        let effect = match definition.effect {
            Effect::AtOnce => "at once",
            Effect::AfterRestart => "after a restart",
        };
        let (name, unit, help) = (definition.name, definition.unit, definition.help);
        writeln!(page, "| `{name}` | {kind}[{count}] | {default} | {allowed} | {unit} | {effect} | {help} |")
            .unwrap();
    }
    page.push_str(LOCK);
    page
}

const LOCK: &str = "
## The lock

With `slipsense.lock` stored as 1 a node starts locked: it refuses every write, every command but identify, and every
update, until it is unlocked. `slipsense.status.locked` shows it. To unlock until the next start:

1. read `slipsense.lock.challenge`, 32 bytes;
2. sign it with an [update key](../board/updates.md): `slipsense sign --challenge HEX --key fleet.key`;
3. send the signature, 64 bytes, as the parameter of ExecuteCommand 2.

A challenge unlocks once, in one start. After a refused signature none is checked for one second. To leave the
lock, unlock, write 0, and store.

A node whose stored settings are damaged starts with the defaults, unlocked. It sets bit 6 (value 64) of the heartbeat's
vendor status and sends a record.
";

#[test]
fn the_page_is_the_table() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/src/bus/settings.md");
    if std::env::var_os("SLIPSENSE_WRITE_PAGES").is_some() {
        std::fs::write(path, page()).unwrap();
    }
    let found = std::fs::read_to_string(path).unwrap();
    let command = "SLIPSENSE_WRITE_PAGES=1 cargo test -p slipsense --test host node::page";
    assert_eq!(found, page(), "make it anew: {command}");
}

/// The numbers of the commands that the other pages name.
#[test]
fn the_pages_name_the_commands() {
    let messages = include_str!("../../docs/src/bus/messages.md");
    let updates = include_str!("../../docs/src/board/updates.md").replace('\n', " ");
    for (page, row) in [
        (messages, format!("| {CALIBRATE} | `0 10` | measures")),
        (messages, format!("| {SCALE_GAIN} | `0 2150` | multiplies")),
        (&updates, format!("{BEGIN_SOFTWARE_UPDATE} for the firmware, {BEGIN_MODEL_UPDATE} for the model")),
        (LOCK, format!("ExecuteCommand {UNLOCK}.")),
        (&self::page(), format!("(ExecuteCommand {STORE})")),
        (&self::page(), format!("a factory reset ({FACTORY_RESET})")),
    ] {
        assert!(page.contains(&row), "{row}");
    }
}
