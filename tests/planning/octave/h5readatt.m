% h5readatt(file, place, attribute): the numbers or the text of an attribute, printed by the program h5dump.
function value = h5readatt(file, place, attribute)
  path = [regexprep(place, "/$", "") "/" attribute];
  [failed, text] = system(sprintf("h5dump -y -a '%s' '%s'", path, file));
  if failed
    error("h5readatt: %s cannot be read", path);
  end
  data = regexp(text, 'DATA \{\s*(.*)\s*\}\s*\}\s*\}', "tokens", "once"){1};
  if any(data == '"')
    value = data;
  else
    value = str2double(strsplit(strtrim(data), ","))(:);
  end
end
