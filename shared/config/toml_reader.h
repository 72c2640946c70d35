// SPDX-License-Identifier: Apache-2.0
// Typed reading of TOML tables: every complaint names file:line, key, value and what is allowed; a key nobody asked for
// is one.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "shared/base/result.h"

namespace stratalux {

// One table of a document. Getters leave `value` alone when the key is absent (the default stands) and remember the
// first error.
class TomlTable {
 public:
  static Result<TomlTable> ParseFile(const std::filesystem::path& file);
  static Result<TomlTable> ParseText(const std::string& text, const std::string& name);

  void Get(const std::string& key, std::string& value);
  void Get(const std::string& key, bool& value);
  void Get(const std::string& key, int& value, int low, int high);
  void Get(const std::string& key, double& value, double low, double high);
  void Get(const std::string& key, std::vector<double>& value, double low, double high);
  void Get(const std::string& key, std::vector<std::string>& value);
  // One of a few words: `index` becomes its place in `words`.
  void GetWord(const std::string& key, size_t& index, const std::vector<std::string>& words);
  [[nodiscard]] bool Has(const std::string& key) const;
  void Require(const std::string& key);
  // The key may be there, but is somebody else's to read.
  void Skip(const std::string& key);
  // Sub-table (empty when absent) and the elements of an array of tables.
  TomlTable Table(const std::string& key);
  std::vector<TomlTable> Tables(const std::string& key);

  // "file:line" of a key, or of the table itself.
  [[nodiscard]] std::string Where(const std::string& key = {}) const;
  // The first error of this table and of those made from it; else kUsage for the first unknown key.
  [[nodiscard]] Status Finish() const;

 private:
  struct Document;
  struct Node;
  TomlTable(std::shared_ptr<Document> document, std::shared_ptr<Node> node);
  void Fail(const std::string& key, const std::string& message);

  std::shared_ptr<Document> document_;
  std::shared_ptr<Node> node_;
};

}  // namespace stratalux
