//! Runs the wire vectors of a profile, the lines of wire.txt, with the codec of that profile.
//!
//! With a decoder of your own, replace `check_beacon`, `shown` and `encoded`.
use dcp_codec::{check_beacon, Beacon, Content, Fault, Value, Writer};

/// The values of a good beacon in wire order.
fn shown(octets: &[u8]) -> String {
    let mut found: Vec<String> = Vec::new();
    let mut show = |value: Value| {
        found.push(match value {
            Value::Unsigned(number) => number.to_string(),
            Value::Signed(number) => number.to_string(),
            Value::Real(number) if number.is_nan() => "nan".to_string(),
            Value::Real(number) => format!("f{:016x}", number.to_bits()),
            Value::Octets(octets) => {
                let digits: String = octets.iter().map(|octet| format!("{octet:02x}")).collect();
                format!("x{digits}")
            }
        })
    };
    let beacon = Beacon::read(octets).expect("a checked beacon");
    beacon.show(&mut show);
    for payload in beacon.payloads {
        let payload = payload.expect("a checked payload");
        payload.show(&mut show);
        match payload.content().expect("a checked content") {
            Content::Srp(report) => report.show(&mut show),
            Content::Vardis(containers) => {
                for container in containers {
                    let container = container.expect("a checked container");
                    container.show(&mut show);
                    container.records.for_each(|record| record.show(&mut show));
                }
            }
            Content::Other(octets) => show(Value::Octets(octets)),
        }
        payload.show_area(&mut show);
    }
    found.join(" ")
}

/// The octets of the values of a good beacon.
fn encoded(octets: &[u8]) -> Result<Vec<u8>, Fault> {
    let mut buffer = vec![0; octets.len()];
    let mut writer = Writer::new(&mut buffer);
    let beacon = Beacon::read(octets).expect("a checked beacon");
    writer.begin_beacon(&beacon)?;
    for payload in beacon.payloads {
        let payload = payload.expect("a checked payload");
        writer.begin_payload(&payload)?;
        match payload.content().expect("a checked content") {
            Content::Srp(report) => writer.add_report(&report)?,
            Content::Vardis(containers) => {
                for container in containers {
                    let container = container.expect("a checked container");
                    writer.begin_container(&container)?;
                    for record in container.records {
                        writer.add_record(&record)?;
                    }
                    writer.end_container()?;
                }
            }
            Content::Other(octets) => writer.add_octets(octets)?,
        }
        writer.end_payload(&payload)?;
    }
    writer.end_beacon()?;
    Ok(writer.written().to_vec())
}

fn from_hex(text: &str) -> Vec<u8> {
    let digits = text.trim_start_matches('-');
    (0..digits.len()).step_by(2).map(|at| u8::from_str_radix(&digits[at..at + 2], 16).expect("hex")).collect()
}

fn or_dash(text: &str) -> &str {
    if text.is_empty() { "-" } else { text }
}

/// What is wrong with the codec for a line; empty: nothing.
fn wrong(field: &[&str]) -> String {
    let octets = from_hex(field[2]);
    let found = match check_beacon(&octets) {
        Ok(size) if field[0] == "V" => format!("{size}\t{}\t{}", field[4], shown(&octets)),
        Ok(_) => "none".to_string(),
        Err(problem) => {
            let (requirement, name) = (or_dash(problem.requirement), or_dash(problem.field));
            let numbers = format!("{}\t{}", problem.needed, problem.available);
            format!("{}\t{}\t{requirement}\t{name}\t{numbers}", problem.reason.name(), problem.offset)
        }
    };
    if found != field[3..].join("\t") {
        return format!("expected {}\n  found    {found}", field[3..].join(" "));
    }
    if field[0] == "V" && field[4] == "both" && encoded(&octets).as_deref() != Ok(&octets[..]) {
        return format!("encoding: expected {}\n  found    {:02x?}", field[2], encoded(&octets));
    }
    String::new()
}

fn main() {
    let path = std::env::args().nth(1).expect("usage: wire wire.txt");
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
    let (mut count, mut failed) = (0, 0);
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let fields: Vec<&str> = line.split('\t').collect();
        let why = wrong(&fields);
        count += 1;
        if !why.is_empty() {
            failed += 1;
            println!("FAIL {}\n  {why}", fields[1]);
        }
    }
    println!("{count} vectors, {failed} failed");
    std::process::exit(i32::from(failed != 0 || count == 0));
}
