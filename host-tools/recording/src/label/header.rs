//! Which column of a test stand's table is what, in which unit.

use csv::StringRecord;

/// What a column holds, and what one of its units is in ours.
#[derive(Clone, Copy, Debug)]
pub(super) struct Quantity {
    names: &'static [&'static str],
    /// Unit and its size; the first is taken where the header names none.
    units: &'static [(&'static str, f64)],
}

pub(super) const TIME: Quantity = Quantity {
    names: &["time", "elapsed time", "test time", "elapsed"],
    units: &[
        ("s", 1.0),
        ("sec", 1.0),
        ("secs", 1.0),
        ("seconds", 1.0),
        ("ms", 1e-3),
        ("msec", 1e-3),
        ("min", 60.0),
    ],
};
pub(super) const TRAVEL: Quantity = Quantity {
    names: &["travel", "displacement", "distance", "position", "extension", "deflection"],
    units: &[("mm", 1.0), ("cm", 10.0), ("m", 1e3), ("um", 1e-3), ("µm", 1e-3), ("in", 25.4), ("inch", 25.4)],
};
pub(super) const LOAD: Quantity = Quantity {
    names: &["load", "force"],
    units: &[
        ("n", 1.0),
        ("mn", 1e-3),
        ("kn", 1e3),
        ("gf", 9.806_65e-3),
        ("kgf", 9.806_65),
        ("ozf", 0.278_013_9),
        ("lbf", 4.448_222),
    ],
};

#[derive(Clone, Debug)]
pub(super) struct Column {
    pub at: usize,
    /// As in the file.
    pub title: String,
    /// One of the file's units in ours.
    pub factor: f64,
    /// The header names no unit.
    pub unit_assumed: bool,
}

impl Quantity {
    fn factor(&self, unit: &str) -> Option<f64> {
        let unit = unit.to_lowercase();
        self.units.iter().find(|(name, _)| *name == unit).map(|(_, factor)| *factor)
    }

    /// The first column of this quantity; its unit may stand in the title or in the row below. The error
    /// is the rule that a unit breaks.
    pub(super) fn find(
        &self,
        titles: &StringRecord,
        units_below: Option<&StringRecord>,
    ) -> Result<Option<Column>, String> {
        for (at, title) in titles.iter().enumerate() {
            let (name, mut unit) = split(title);
            let last_word = name.rsplit_once(' ').filter(|(_, unit)| self.factor(unit).is_some());
            let name = match last_word {
                Some((name, word)) if unit.is_none() => {
                    unit = Some(word.to_owned());
                    name.to_owned()
                }
                _ => name,
            };
            if !self.names.contains(&name.as_str()) {
                continue;
            }
            let below =
                units_below.and_then(|row| row.get(at)).map(|cell| split(cell).1.unwrap_or(split(cell).0));
            let unit = unit.or(below).filter(|unit| !unit.is_empty());
            let factor = match &unit {
                None => 1.0,
                Some(unit) => self.factor(unit).ok_or_else(|| {
                    let known: Vec<_> = self.units.iter().map(|(name, _)| *name).collect();
                    format!("column {title:?}: unit must be one of {}", known.join(", "))
                })?,
            };
            let title = title.trim().to_owned();
            return Ok(Some(Column { at, title, factor, unit_assumed: unit.is_none() }));
        }
        Ok(None)
    }
}

/// Name in small letters, and the unit in brackets.
fn split(title: &str) -> (String, Option<String>) {
    let clean = |text: &str| text.replace('_', " ").trim().to_lowercase();
    match title.find(['[', '(']) {
        Some(at) => {
            let unit = title[at + 1..].trim().trim_end_matches([']', ')']);
            (clean(&title[..at]), Some(unit.trim().to_lowercase()))
        }
        None => (clean(title), None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn find(
        quantity: Quantity,
        titles: &[&str],
        below: Option<&[&str]>,
    ) -> Result<Option<(usize, f64)>, String> {
        let below = below.map(|cells| StringRecord::from(cells.to_vec()));
        let found = quantity.find(&StringRecord::from(titles.to_vec()), below.as_ref())?;
        Ok(found.map(|column| (column.at, column.factor)))
    }

    #[test]
    fn titles_and_units_as_people_write_them() {
        let mark10 = ["Reading", "Load [N]", "Travel [mm]", "Time [sec]"];
        assert_eq!(find(TIME, &mark10, None), Ok(Some((3, 1.0))));
        assert_eq!(find(TRAVEL, &mark10, None), Ok(Some((2, 1.0))));
        assert_eq!(find(LOAD, &mark10, None), Ok(Some((1, 1.0))));
        for (title, factor) in [
            ("travel (in)", 25.4),
            (" Displacement_mm ", 1.0),
            ("Position µm", 1e-3),
            ("DISTANCE [ cm ]", 10.0),
            ("Travel", 1.0),
        ] {
            assert_eq!(find(TRAVEL, &[title], None), Ok(Some((0, factor))), "{title}");
        }
        assert_eq!(find(TIME, &["Time"], Some(&["ms"])), Ok(Some((0, 1e-3))));
        assert_eq!(find(TIME, &["Time"], Some(&["[s]"])), Ok(Some((0, 1.0))));
        assert_eq!(find(TRAVEL, &["Travel limit", "Peak travel"], None), Ok(None));
    }

    #[test]
    fn an_unknown_unit_is_refused() {
        let error = find(TRAVEL, &["Travel [furlong]"], None).unwrap_err();
        assert_eq!(error, "column \"Travel [furlong]\": unit must be one of mm, cm, m, um, µm, in, inch");
    }
}
