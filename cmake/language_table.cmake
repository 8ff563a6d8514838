# Makes the table of a language, as JSON, from its .po file: cmake -DPO=de.po -DTABLE=de.json -P language_table.cmake
# msgfmt refuses a translation that lacks a place of its sentence or has another one.
execute_process(COMMAND msgfmt --check-format --check-domain --output-file=/dev/null ${PO} COMMAND_ERROR_IS_FATAL ANY)
execute_process(COMMAND msgcat --no-wrap --stringtable-output ${PO} OUTPUT_VARIABLE table COMMAND_ERROR_IS_FATAL ANY)
# Each entry is a line `"English" = "translation";`. The first one is the header of the file, comments are lines of their own.
set(text "\"(([^\"\\]|\\\\.)*)\"")
string(FIND "${table}" "\"\" = " header)
string(SUBSTRING "${table}" ${header} -1 table)
string(REGEX REPLACE "\n/\\*[^\n]*" "" table "${table}")
string(REGEX REPLACE "\n${text} = ${text};" ",\n\"\\1\": \"\\3\"" table "${table}")
string(REGEX REPLACE "\n+,\n" ",\n" table "${table}")
string(REGEX REPLACE "\"\" = [^\n]*;," "{" table "${table}")
file(WRITE ${TABLE} "${table}}\n")
