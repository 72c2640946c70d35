// SPDX-License-Identifier: Apache-2.0
#include "shared/config/toml_reader.h"

#include <algorithm>
#include <sstream>

#include <toml++/toml.h>

#include "shared/base/read_file.h"
#include "shared/config/toml_nesting.h"

namespace stratalux {

struct TomlTable::Document {
  toml::table root;
  std::string name;
  Status error;
};

struct TomlTable::Node {
  const toml::table* table = nullptr;  // null: absent
  std::string path;                    // "plan." in front of keys
  std::set<std::string> asked;
  std::vector<std::shared_ptr<Node>> children;
};

namespace {

std::string Text(const toml::node& node) {
  std::ostringstream text;
  node.visit([&](const auto& value) { text << value; });
  return text.str();
}

// Written by hand, or an import of some ten thousand entries.
constexpr int64_t kMostTomlBytes = int64_t{16} << 20;

std::string Number(double v) {
  std::ostringstream text;
  text << v;
  return text.str();
}

}  // namespace

TomlTable::TomlTable(std::shared_ptr<Document> document, std::shared_ptr<Node> node)
    : document_(std::move(document)), node_(std::move(node)) {}

Result<TomlTable> TomlTable::ParseFile(const std::filesystem::path& file) {
  const auto text = ReadFile(file, kMostTomlBytes);
  if (!text.ok()) return Status::Usage(text.status().message());
  return ParseText(*text, file.string());
}

Result<TomlTable> TomlTable::ParseText(const std::string& text, const std::string& name) {
  auto document = std::make_shared<Document>();
  document->name = name;
  if (const Status keys = CheckKeyParts(text); !keys.ok()) return Status::Usage(name + ":" + keys.message());
  try {
    document->root = toml::parse(text, name);
  } catch (const toml::parse_error& error) {
    return Status::Usage(name + ":" + std::to_string(error.source().begin.line) + ": " +
                         std::string(error.description()));
  }
  auto node = std::make_shared<Node>();
  node->table = &document->root;
  return TomlTable(document, node);
}

std::string TomlTable::Where(const std::string& key) const {
  if (node_->table == nullptr) return document_->name;
  const toml::node* node = key.empty() ? node_->table : node_->table->get(key);
  if (node == nullptr) node = node_->table;
  return document_->name + ":" + std::to_string(node->source().begin.line);
}

void TomlTable::Fail(const std::string& key, const std::string& message) {
  if (document_->error.ok()) document_->error = Status::Usage(Where(key) + ": " + node_->path + key + ": " + message);
}

bool TomlTable::Has(const std::string& key) const { return node_->table != nullptr && node_->table->contains(key); }

void TomlTable::Require(const std::string& key) {
  node_->asked.insert(key);
  if (!Has(key)) Fail(key, "is missing");
}

void TomlTable::Skip(const std::string& key) { node_->asked.insert(key); }

void TomlTable::Get(const std::string& key, std::string& value) {
  node_->asked.insert(key);
  if (!Has(key)) return;
  const toml::node& node = *node_->table->get(key);
  if (const auto v = node.value_exact<std::string>()) {
    value = *v;
  } else {
    Fail(key, "value " + Text(node) + " is not a string");
  }
}

void TomlTable::Get(const std::string& key, bool& value) {
  node_->asked.insert(key);
  if (!Has(key)) return;
  const toml::node& node = *node_->table->get(key);
  if (const auto v = node.value_exact<bool>()) {
    value = *v;
  } else {
    Fail(key, "value " + Text(node) + " is not true or false");
  }
}

void TomlTable::Get(const std::string& key, int& value, int low, int high) {
  node_->asked.insert(key);
  if (!Has(key)) return;
  const toml::node& node = *node_->table->get(key);
  const auto v = node.value_exact<int64_t>();
  if (v && *v >= low && *v <= high) {
    value = static_cast<int>(*v);
  } else {
    Fail(key, "value " + Text(node) + (v ? " is out of range" : " is not an integer") +
                  ", allowed: " + std::to_string(low) + " .. " + std::to_string(high));
  }
}

void TomlTable::Get(const std::string& key, double& value, double low, double high) {
  node_->asked.insert(key);
  if (!Has(key)) return;
  const toml::node& node = *node_->table->get(key);
  const auto v = node.is_number() ? node.value<double>() : std::nullopt;
  if (v && *v >= low && *v <= high) {
    value = *v;
  } else {
    Fail(key, "value " + Text(node) + (v ? " is out of range" : " is not a number") + ", allowed: " + Number(low) +
                  " .. " + Number(high));
  }
}

void TomlTable::Get(const std::string& key, std::vector<double>& value, double low, double high) {
  node_->asked.insert(key);
  if (!Has(key)) return;
  const toml::array* array = node_->table->get(key)->as_array();
  std::vector<double> read;
  for (size_t i = 0; array != nullptr && i < array->size(); ++i) {
    const auto v = array->get(i)->value<double>();
    if (!v || !(*v >= low && *v <= high))
      return Fail(key, "element " + std::to_string(i) + ", " + Text(*array->get(i)) +
                           (v ? ", is out of range" : ", is not a number") + ", allowed: " + Number(low) + " .. " +
                           Number(high));
    read.push_back(*v);
  }
  if (read.empty()) return Fail(key, "must be a non-empty list of numbers");
  value = read;
}

void TomlTable::Get(const std::string& key, std::vector<std::string>& value) {
  node_->asked.insert(key);
  if (!Has(key)) return;
  const toml::array* array = node_->table->get(key)->as_array();
  if (array == nullptr) return Fail(key, "must be a list of strings");
  std::vector<std::string> read;
  for (const toml::node& element : *array) {
    const auto v = element.value_exact<std::string>();
    if (!v) return Fail(key, "must be a list of strings");
    read.push_back(*v);
  }
  value = read;
}

void TomlTable::GetWord(const std::string& key, size_t& index, const std::vector<std::string>& words) {
  node_->asked.insert(key);
  if (!Has(key)) return;
  const toml::node& node = *node_->table->get(key);
  const auto v = node.value_exact<std::string>();
  const auto found = v ? std::find(words.begin(), words.end(), *v) : words.end();
  if (found != words.end()) {
    index = static_cast<size_t>(found - words.begin());
    return;
  }
  std::string allowed;
  for (const std::string& word : words) allowed += (allowed.empty() ? "" : ", ") + word;
  Fail(key, "value " + Text(node) + " is unknown, allowed: " + allowed);
}

TomlTable TomlTable::Table(const std::string& key) {
  node_->asked.insert(key);
  auto child = std::make_shared<Node>();
  child->path = node_->path + key + ".";
  if (Has(key)) {
    child->table = node_->table->get(key)->as_table();
    if (child->table == nullptr) Fail(key, "must be a table");
  }
  node_->children.push_back(child);
  return {document_, child};
}

std::vector<TomlTable> TomlTable::Tables(const std::string& key) {
  node_->asked.insert(key);
  std::vector<TomlTable> tables;
  if (!Has(key)) return tables;
  const toml::array* array = node_->table->get(key)->as_array();
  if (array == nullptr || !array->is_array_of_tables()) {
    Fail(key, "must be an array of tables [[" + key + "]]");
    return tables;
  }
  for (const toml::node& element : *array) {
    auto child = std::make_shared<Node>();
    child->path = node_->path + key + "[" + std::to_string(tables.size()) + "].";
    child->table = element.as_table();
    node_->children.push_back(child);
    tables.push_back({document_, child});
  }
  return tables;
}

Status TomlTable::Finish() const {
  if (!document_->error.ok()) return document_->error;
  if (node_->table != nullptr)
    for (const auto& [key, value] : *node_->table) {
      if (node_->asked.contains(std::string(key.str()))) continue;
      std::string known;
      for (const std::string& name : node_->asked) known += (known.empty() ? "; known: " : ", ") + name;
      return Status::Usage(document_->name + ":" + std::to_string(key.source().begin.line) + ": unknown key '" +
                           node_->path + std::string(key.str()) + "'" + known);
    }
  for (const auto& child : node_->children) SLX_RETURN_IF_ERROR(TomlTable(document_, child).Finish());
  return Status::Ok();
}

}  // namespace stratalux
