//! The verdicts of a campaign in a file, so that it can end at any time and go on later.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;

use anyhow::{Context, Result, ensure};

/// Exit status of a child without a verdict: it took too long, or the emulator failed.
pub const NO_VERDICT: u8 = 0;

#[derive(Default)]
pub struct Results {
    file: Option<File>,
    /// By the number of the fault.
    pub verdicts: BTreeMap<usize, u8>,
}

impl Results {
    /// `campaign`, one line, says what the verdicts are of: a file of another one is refused. No path: no file.
    pub fn open(path: Option<&Path>, campaign: &str) -> Result<Self> {
        let Some(path) = path else { return Ok(Self::default()) };
        Self::of(path, campaign).with_context(|| path.display().to_string())
    }

    fn of(path: &Path, campaign: &str) -> Result<Self> {
        let mut file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
        let mut text = String::new();
        file.read_to_string(&mut text)?;
        // A run that was killed may have left half a line.
        let whole = text.rfind('\n').map_or(0, |end| end + 1);
        let mut lines = text[..whole].lines();
        let first = lines.next();
        ensure!(
            first.map_or(campaign.starts_with(&text), |first| first == campaign),
            "is not of this campaign\n  in the file: {}\n  this one:    {campaign}",
            first.unwrap_or(&text)
        );
        let mut verdicts = BTreeMap::new();
        for (line, number) in lines.zip(2..) {
            let (fault, verdict) = line
                .split_once(',')
                .and_then(|(fault, verdict)| Some((fault.parse().ok()?, verdict.parse().ok()?)))
                .with_context(|| {
                    format!("line {number}: `{line}`, expected the number of a fault, verdict")
                })?;
            // A child that was ended runs again.
            if verdict != NO_VERDICT {
                verdicts.insert(fault, verdict);
            }
        }
        file.set_len(whole as u64)?;
        file.seek(SeekFrom::End(0))?;
        if first.is_none() {
            writeln!(file, "{campaign}")?;
        }
        Ok(Self { file: Some(file), verdicts })
    }

    pub fn add(&mut self, fault: usize, verdict: u8) -> Result<()> {
        self.verdicts.insert(fault, verdict);
        match &mut self.file {
            Some(file) => writeln!(file, "{fault},{verdict}").context("cannot write the verdicts"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_campaign_goes_on_where_it_ended() {
        let path = std::env::temp_dir().join(format!("verdicts-{}", std::process::id()));
        let open = |campaign| Results::open(Some(&path), campaign);
        open("a").unwrap().add(7, 2).unwrap();
        open("a").unwrap().add(9, NO_VERDICT).unwrap();
        std::fs::write(&path, std::fs::read_to_string(&path).unwrap() + "8,").unwrap();
        let mut again = open("a").unwrap();
        assert_eq!(again.verdicts, [(7, 2)].into());
        again.add(8, 3).unwrap();
        assert_eq!(open("a").unwrap().verdicts, [(7, 2), (8, 3)].into());
        assert!(format!("{:#}", open("b").err().unwrap()).contains("not of this campaign"));
        std::fs::write(&path, "a\n8;3\n").unwrap();
        assert!(format!("{:#}", open("a").err().unwrap()).contains("line 2: `8;3`"));
        std::fs::write(&path, "another file, without a line's end").unwrap();
        assert!(format!("{:#}", open("a").err().unwrap()).contains("another file"));
        assert_eq!(std::fs::read(&path).unwrap(), b"another file, without a line's end");
        std::fs::remove_file(&path).unwrap();
    }
}
