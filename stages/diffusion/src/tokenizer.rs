//! CLIP's tokenizer: byte-level byte-pair encoding (Sennrich et al. 2016) of cleaned-up,
//! lower-cased text.
//!
//! Gives the ids that `CLIPTokenizer(..., padding="max_length", truncation=True)` of transformers
//! gives. Knows no model.

use std::collections::BTreeMap;

use regex::Regex;
use serde::Deserialize;
use serde_json::json;
use unicode_normalization::UnicodeNormalization;

use crate::config::{self, TextConfig};
use crate::error::ModelError;
use crate::source::ModelSource;
use crate::tokenizer_json::{self, Tables};

/// Contractions, words, single digits and runs of other signs.
// The pattern of OpenAI's `simple_tokenizer.py` but for its special tokens, which `encode` cuts out
// before.
const WORDS: &str = r"'s|'t|'re|'ve|'m|'ll|'d|\p{L}+|\p{N}|[^\s\p{L}\p{N}]+";

/// What marks the end of a word in the vocabulary.
const END: &str = "</w>";

/// Text to token ids.
pub struct Tokenizer {
    vocabulary: BTreeMap<String, u32>,
    /// Pairs of symbols, joined by a space, in the order in which they are merged.
    merges: BTreeMap<String, usize>,
    words: Regex,
    spaces: Regex,
    specials: Regex,
    begin: u32,
    end: u32,
    pad: u32,
    unknown: u32,
    length: usize,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct TokenizerConfig {
    added_tokens_decoder: Option<serde_json::Value>,
    // A float, since transformers writes 1e30 where there is no limit, which 64 bits do not hold.
    model_max_length: Option<f64>,
    #[serde(flatten)]
    specials: Specials,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Specials {
    bos_token: Option<Special>,
    eos_token: Option<Special>,
    pad_token: Option<Special>,
    unk_token: Option<Special>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Special {
    Text(String),
    Token { content: String },
}

impl Special {
    /// The first of the candidates, or CLIP's own default.
    fn choose(candidates: [Option<Self>; 2], default: &str) -> String {
        match candidates.into_iter().flatten().next() {
            Some(Self::Text(text) | Self::Token { content: text }) => text,
            None => default.to_owned(),
        }
    }
}

impl Tokenizer {
    /// Reads the tokenizer of a text encoder. Fails where it gives ids that the encoder does not
    /// know; and, where somebody put it beside a single file, also where it gives fewer.
    pub fn load(source: &ModelSource, text: &TextConfig) -> Result<Self, ModelError> {
        let tokenizer = Self::read(source, text.max_position_embeddings)?;
        let largest = tokenizer.vocabulary.values().copied().max().unwrap_or(0) as usize;
        let known = text.vocab_size;
        let problem = match source {
            _ if largest >= known => {
                format!("has the id {largest}; the text encoder knows {known} ids")
            }
            ModelSource::File(_) if largest + 1 < known => format!(
                "has ids up to {largest}; the text encoder knows {known} ids: this is the vocabulary of another model"
            ),
            _ => return Ok(tokenizer),
        };
        Err(ModelError::file(Self::tables(source)?.0, problem))
    }

    /// Reads the files of `tokenizer/`; `longest` is the number of positions that the text encoder
    /// has.
    fn read(source: &ModelSource, longest: usize) -> Result<Self, ModelError> {
        let (name, tables) = Self::tables(source)?;
        let mut config = match source.find("tokenizer/tokenizer_config.json")? {
            Some(file) => config::parse::<TokenizerConfig>(&file, &json!({}), &[])?,
            None => TokenizerConfig::default(),
        };
        let map = match source.find("tokenizer/special_tokens_map.json")? {
            // Newer files say all in the configuration.
            Some(file) if config.added_tokens_decoder.is_none() => {
                config::parse(&file, &json!({}), &[])?
            }
            _ => Specials::default(),
        };
        let own = std::mem::take(&mut config.specials);
        let names = [
            Special::choose([map.bos_token, own.bos_token], "<|startoftext|>"),
            Special::choose([map.eos_token, own.eos_token], "<|endoftext|>"),
            Special::choose([map.pad_token, own.pad_token], "<|endoftext|>"),
            Special::choose([map.unk_token, own.unk_token], "<|endoftext|>"),
        ];
        // `as` makes 0 of what is below it or no number: a text of no tokens.
        let length = config
            .model_max_length
            .map_or(longest, |length| longest.min(length as usize));
        if length == 0 {
            return Err(ModelError::field(
                &name,
                "model_max_length",
                "leaves no room for a token",
            ));
        }
        Self::new(tables, &names, length).map_err(|problem| ModelError::file(&name, problem))
    }

    /// The vocabulary and its merges, from `vocab.json` and `merges.txt` or else from `tokenizer.json`, and the name of the
    /// file with the vocabulary.
    fn tables(source: &ModelSource) -> Result<(String, Tables), ModelError> {
        let alone = source.find("tokenizer/tokenizer.json")?;
        let Some(file) = source.find("tokenizer/vocab.json")? else {
            let file = match alone {
                Some(file) => file,
                None => source.file("tokenizer/vocab.json")?,
            };
            return Ok((file.name().to_owned(), tokenizer_json::read(&file)?));
        };
        let vocabulary = serde_json::from_slice(&file).map_err(|e| {
            ModelError::file(file.name(), format!("is not a JSON object of ids: {e}"))
        })?;
        let merges = source.file("tokenizer/merges.txt")?;
        let merges = String::from_utf8_lossy(&merges)
            .lines()
            // The first line is a version, and a line without a space is no pair.
            .filter(|line| !line.starts_with("#version") && line.contains(' '))
            .map(|pair| pair.trim_end().to_owned())
            .collect();
        Ok((file.name().to_owned(), Tables { vocabulary, merges }))
    }

    fn new(tables: Tables, names: &[String; 4], length: usize) -> Result<Self, String> {
        let Tables { vocabulary, merges } = tables;
        let id = |name: &String| {
            vocabulary
                .get(name)
                .copied()
                .ok_or_else(|| format!("lacks the token {name:?}"))
        };
        let [begin, end, pad, unknown] = [
            id(&names[0])?,
            id(&names[1])?,
            id(&names[2])?,
            id(&names[3])?,
        ];
        let mut longest_first = names.clone().map(|name| regex::escape(&name));
        // An alternation takes the first that fits: a token must stand before one that it begins
        // with.
        longest_first.sort_by_key(|name| std::cmp::Reverse(name.len()));
        let regex = |pattern: &str| Regex::new(pattern).map_err(|e| e.to_string());
        let ranked = merges.into_iter().enumerate();
        Ok(Self {
            merges: ranked.map(|(rank, pair)| (pair, rank)).collect(),
            words: regex(WORDS)?,
            spaces: regex(r"\s+")?,
            specials: regex(&longest_first.join("|"))?,
            begin,
            end,
            pad,
            unknown,
            length,
            vocabulary,
        })
    }

    /// How many ids a text becomes.
    pub fn length(&self) -> usize {
        self.length
    }

    /// The ids of `text` between those of its begin and end, cut or filled to
    /// [`Tokenizer::length`].
    pub fn encode(&self, text: &str) -> Vec<u32> {
        let mut ids = vec![self.begin];
        let mut rest = 0;
        for special in self.specials.find_iter(text) {
            self.encode_plain(&text[rest..special.start()], &mut ids);
            ids.push(self.id(special.as_str()));
            rest = special.end();
        }
        self.encode_plain(&text[rest..], &mut ids);
        // A text that is cut still ends with its end mark.
        ids.truncate(self.length.saturating_sub(1));
        ids.push(self.end);
        ids.resize(self.length, self.pad);
        ids
    }

    fn encode_plain(&self, text: &str, ids: &mut Vec<u32>) {
        // In the order of CLIPTokenizerFast's normaliser: NFC, then spaces, then lower case.
        let composed: String = text.nfc().collect();
        let lower: String = self
            .spaces
            .replace_all(&composed, " ")
            .chars()
            // Letter by letter, as the tokenizers library does. `str::to_lowercase` treats a final
            // sigma otherwise.
            .flat_map(char::to_lowercase)
            .collect();
        for word in self.words.find_iter(&lower) {
            ids.extend(
                self.merge(word.as_str())
                    .iter()
                    .map(|symbol| self.id(symbol)),
            );
        }
    }

    fn id(&self, symbol: &str) -> u32 {
        self.vocabulary.get(symbol).copied().unwrap_or(self.unknown)
    }

    /// A word's symbols: its bytes, merged pair by pair in the order of `merges`.
    fn merge(&self, word: &str) -> Vec<String> {
        let mut symbols: Vec<String> = word.bytes().map(|byte| letter(byte).to_string()).collect();
        // Part of the last symbol and not one of its own: merges count it so.
        if let Some(last) = symbols.last_mut() {
            last.push_str(END);
        }
        while let Some((_, first)) = self.best_pair(&symbols) {
            let pair = [symbols[first].clone(), symbols[first + 1].clone()];
            // All places of the pair at once, as the reference merges them.
            let mut i = first;
            while i + 1 < symbols.len() {
                if symbols[i..i + 2] == pair {
                    symbols[i] = pair.concat();
                    symbols.remove(i + 1);
                }
                i += 1;
            }
        }
        symbols
    }

    /// The rank and place of the pair that is merged next.
    fn best_pair(&self, symbols: &[String]) -> Option<(usize, usize)> {
        let rank = |(i, pair): (usize, &[String])| Some((*self.merges.get(&pair.join(" "))?, i));
        // The least rank, and of equal ones the first in the word.
        symbols.windows(2).enumerate().filter_map(rank).min()
    }
}

/// The printable letter that stands for a byte: itself where it is one, else one from U+0100 on, in
/// order.
fn letter(byte: u8) -> char {
    // The letters of GPT-2's `bytes_to_unicode`: in files of merges a space parts symbols, so that
    // no symbol may hold one.
    let printable = |b: &u8| matches!(b, 33..=126 | 161..=172 | 174..=255);
    if printable(&byte) {
        return char::from(byte);
    }
    let before = (0..byte).filter(|b| !printable(b)).count() as u32;
    char::from_u32(256 + before).unwrap_or(char::REPLACEMENT_CHARACTER)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_have_distinct_printable_letters() {
        let letters: std::collections::BTreeSet<char> = (0..=255).map(letter).collect();
        assert_eq!(letters.len(), 256);
        assert_eq!(
            [letter(b'a'), letter(b' '), letter(0), letter(173)],
            ['a', 'Ġ', 'Ā', 'Ń']
        );
    }

    /// transformers 5 writes one file instead of two.
    #[test]
    fn one_file_gives_the_same_ids_as_two() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("tokenizer");
        std::fs::create_dir(&place).unwrap();
        let embedded = |name: &str| {
            ModelSource::Embedded
                .file(&format!("tokenizer/{name}"))
                .unwrap()
        };
        let (_, tables) = Tokenizer::tables(&ModelSource::Embedded).unwrap();
        let pairs: Vec<_> = tables
            .merges
            .iter()
            .map(|pair| pair.split(' ').collect::<Vec<_>>())
            .collect();
        let config = embedded("tokenizer_config.json");
        std::fs::write(place.join("tokenizer_config.json"), &*config).unwrap();
        for merges in [json!(pairs), json!(tables.merges)] {
            let model = json!({"type": "BPE", "vocab": tables.vocabulary, "merges": merges});
            let page = json!({"version": "1.0", "added_tokens": [], "model": model});
            std::fs::write(place.join("tokenizer.json"), page.to_string()).unwrap();
            let one = Tokenizer::read(&ModelSource::Folder(folder.path().into()), 77).unwrap();
            let two = Tokenizer::read(&ModelSource::Embedded, 77).unwrap();
            for text in ["a photograph of a fern, 4k", "still life 1999", ""] {
                assert_eq!(one.encode(text), two.encode(text), "{text}");
            }
        }
        let page = json!({"model": {"type": "WordPiece", "vocab": {}, "merges": []}});
        std::fs::write(place.join("tokenizer.json"), page.to_string()).unwrap();
        let refused = Tokenizer::read(&ModelSource::Folder(folder.path().into()), 77);
        let said = refused.err().unwrap().to_string();
        assert!(
            said.contains("tokenizer.json") && said.contains("WordPiece"),
            "{said}"
        );
    }

    #[test]
    fn a_text_is_framed_cut_and_filled() {
        let tokenizer = Tokenizer::read(&ModelSource::Embedded, 8).unwrap();
        let begin = tokenizer.begin;
        let end = tokenizer.end;
        assert_eq!(
            tokenizer.encode(""),
            [begin, end, end, end, end, end, end, end]
        );
        let long = tokenizer.encode("0 1 2 3 4 5 6 7 8 9");
        assert_eq!((long.len(), long[0], long[7]), (8, begin, end));
        assert_eq!(
            long[1..7],
            (0..6)
                .map(|i| tokenizer.id(&format!("{i}</w>")))
                .collect::<Vec<_>>()
        );
    }
}
